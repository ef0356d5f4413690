#include "machine/detail/expressions.h"

#include "machine/detail/reader_core.h"

namespace lightmill::detail {

namespace {
constexpr int kDeepest = 40;

bool is_letter(char c) {
  return c >= 'A' && c <= 'Z';
}
}  // namespace

double sine(double degrees) {
  return std::sin(degrees * kRadPerDegree);
}
double cosine(double degrees) {
  return std::cos(degrees * kRadPerDegree);
}
double tangent(double degrees) {
  return std::tan(degrees * kRadPerDegree);
}
double arc_sine(double x) {
  return std::asin(x) / kRadPerDegree;
}
double arc_cosine(double x) {
  return std::acos(x) / kRadPerDegree;
}
double arc_tangent(double y, double x) {
  return std::atan2(y, x) / kRadPerDegree;
}

void ExpressionReader::expect(char c) {
  if (grammar_->blanks) skip_blanks();
  if (!take({&c, 1})) reject(column(), std::string("'") + c + "' is missing");
}

double ExpressionReader::value(int depth) {
  if (depth > kDeepest) reject(column(), "expression nested too deeply");
  if (grammar_->blanks) skip_blanks();
  if (p_ == end_) reject(column(), "a value is missing");
  if (take("-")) return -value(depth + 1);
  if (take("+")) return value(depth + 1);
  double v = 0;
  if ((*p_ >= '0' && *p_ <= '9') || *p_ == '.') {
    if (!read_digits(p_, end_, v, &point_)) reject(column(), "bad number format");
    return v;
  }
  if (*p_ == grammar_->open)
    v = bracket(depth + 1);
  else if (!operand(v, depth + 1))
    v = function(depth + 1);
  point_ = true;
  return v;
}

double ExpressionReader::function(int depth) {
  for (const auto& [name, apply] : grammar_->pair_functions) {
    if (!take(name)) continue;
    expect(grammar_->open);
    const double a = level(0, depth);
    expect(',');
    const double b = level(0, depth);
    expect(grammar_->close);
    return apply(a, b);
  }
  for (const auto& [name, apply] : grammar_->functions) {
    if (!take(name)) continue;
    const double v = apply(grammar_->bare_arguments ? value(depth) : bracket(depth));
    if (!std::isfinite(v)) reject(column(), std::string(name) + " of a value out of its range");
    return v;
  }
  reject(column(), "bad number format");
}

double ExpressionReader::bracket(int depth) {
  expect(grammar_->open);
  const double v = level(0, depth);
  expect(grammar_->close);
  return v;
}

double ExpressionReader::level(int strength, int depth) {
  if (depth > kDeepest) reject(column(), "expression nested too deeply");
  if (strength == grammar_->strengths) return value(depth + 1);
  double a = level(strength + 1, depth);
  for (;;) {
    const char* const before = p_;
    if (grammar_->blanks) skip_blanks();
    const std::string_view rest(p_, static_cast<std::size_t>(end_ - p_));
    const Grammar::Operator* longest = nullptr;
    for (const Grammar::Operator& o : grammar_->operators) {
      if (!rest.starts_with(o.word) || (longest != nullptr && o.word.size() <= longest->word.size())) continue;
      const bool goes_on = is_letter(o.word.back()) && rest.size() > o.word.size() && is_letter(rest[o.word.size()]);
      if (!grammar_->blanks || !goes_on) longest = &o;
    }
    if (longest == nullptr || longest->strength != strength) {
      p_ = before;
      return a;
    }
    const int where = column();
    p_ += longest->word.size();
    a = longest->apply(a, level(strength + 1, depth));
    if (!std::isfinite(a)) reject(where, "the result is no number");
  }
}

}  // namespace lightmill::detail
