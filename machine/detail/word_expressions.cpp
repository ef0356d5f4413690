// Values of RS274/NGC: numbers, parameters, functions, expressions.
#include "machine/detail/word_reader.h"

namespace lightmill::detail {

double WordReader::value(int depth) {
  if (depth > 40) reject(column(), "expression nested too deeply");
  if (p_ == end_) reject(column(), "a value is missing");
  if (take("-")) return -value(depth + 1);
  if (take("+")) return value(depth + 1);
  double v = 0;
  if ((*p_ >= '0' && *p_ <= '9') || *p_ == '.') {
    if (!read_digits(p_, end_, v, &point_)) reject(column(), "bad number format");
    return v;
  }
  point_ = true;
  if (fanuc_) reject(column(), "a number is missing");
  if (*p_ == '[') return bracket(depth + 1);
  if (*p_ == '#') return parameter(depth + 1);
  struct Function {
    const char* name;
    double (*f)(double);
  };
  static const Function kFunctions[] = {{"ABS", [](double x) { return std::abs(x); }},
                                        {"ACOS", [](double x) { return std::acos(x) / kRadPerDegree; }},
                                        {"ASIN", [](double x) { return std::asin(x) / kRadPerDegree; }},
                                        {"COS", [](double x) { return std::cos(x * kRadPerDegree); }},
                                        {"EXP", [](double x) { return std::exp(x); }},
                                        {"FIX", [](double x) { return std::floor(x); }},
                                        {"FUP", [](double x) { return std::ceil(x); }},
                                        {"LN", [](double x) { return std::log(x); }},
                                        {"ROUND", [](double x) { return std::round(x); }},
                                        {"SIN", [](double x) { return std::sin(x * kRadPerDegree); }},
                                        {"SQRT", [](double x) { return std::sqrt(x); }},
                                        {"TAN", [](double x) { return std::tan(x * kRadPerDegree); }}};
  if (take("ATAN")) {
    const double y = bracket(depth + 1);
    if (!take("/")) reject(column(), "ATAN needs [y]/[x]");
    return std::atan2(y, bracket(depth + 1)) / kRadPerDegree;
  }
  if (take("EXISTS[#<")) {
    const std::string name = name_end();
    if (!take("]")) reject(column(), "']' is missing");
    return named(name) != nullptr ? 1 : 0;
  }
  for (const Function& function : kFunctions) {
    if (!take(function.name)) continue;
    v = function.f(bracket(depth + 1));
    if (!std::isfinite(v)) reject(column(), std::string(function.name) + " of a value out of its range");
    return v;
  }
  reject(column(), "bad number format");
}

std::string WordReader::name_end() {
  const char* close = std::find(p_, end_, '>');
  if (close == end_) reject(column(), "'>' is missing");
  std::string name(p_, close);
  p_ = close + 1;
  return name;
}

double* WordReader::named(const std::string& name) {
  auto& names = name.starts_with('_') ? globals_ : locals_.back();
  const auto found = names.find(name);
  return found == names.end() ? nullptr : &found->second;
}

double WordReader::parameter(int depth) {
  ++p_;  // #
  const int where = column();
  if (take("<")) {
    const std::string name = name_end();
    if (const double* known = named(name)) return *known;
    static constexpr const char* kAxes[] = {"_X", "_Y", "_Z"};
    for (std::size_t i = 0; i < 3; ++i) {
      if (name == kAxes[i]) return (compensation_.on() ? compensation_.centre() : place())[i] / unit_;
    }
    if (name == "_METRIC") return unit_ == 1;
    if (name == "_IMPERIAL") return unit_ != 1;
    if (name == "_FEED") return feed_ / unit_;
    if (name == "_RPM") return rpm_;
    reject(where, "parameter #<" + name + "> was never set");
  }
  return numbered(address(value(depth), where));
}

int WordReader::address(double v, int where) {
  if (!(v >= 1 && v <= 5602) || v != std::floor(v)) reject(where, "parameter numbers are whole and from 1 to 5602");
  return static_cast<int>(v);
}

double WordReader::numbered(int n) {
  if (n >= 5420 && n <= 5422) {
    if (compensation_.on()) reject(column(), "the position is not known while cutter compensation is on");
    return place()[static_cast<std::size_t>(n - 5420)] / unit_;
  }
  if (n == 5400) return tool_;
  const auto found = numbers_.find(n);
  return found == numbers_.end() ? 0 : found->second;
}

double WordReader::bracket(int depth) {
  if (!take("[")) reject(column(), "'[' is missing");
  const double v = level(0, depth);
  if (!take("]")) reject(column(), "']' is missing");
  return v;
}

/// Levels from loose to tight: logic, comparison, sum, product, power; all from left to right.
double WordReader::level(int strength, int depth) {
  if (depth > 40) reject(column(), "expression nested too deeply");
  if (strength == 5) return value(depth + 1);
  double a = level(strength + 1, depth);
  for (;;) {
    const int where = column();
    const auto b = [&] { return level(strength + 1, depth); };
    if (strength == 0 && take("AND")) {
      const double r = b();
      a = a != 0 && r != 0;
    } else if (strength == 0 && take("XOR")) {
      const double r = b();
      a = (a != 0) != (r != 0);
    } else if (strength == 0 && take("OR")) {
      const double r = b();
      a = a != 0 || r != 0;
    } else if (strength == 1 && take("EQ"))
      a = a == b();
    else if (strength == 1 && take("NE"))
      a = a != b();
    else if (strength == 1 && take("GT"))
      a = a > b();
    else if (strength == 1 && take("GE"))
      a = a >= b();
    else if (strength == 1 && take("LT"))
      a = a < b();
    else if (strength == 1 && take("LE"))
      a = a <= b();
    else if (strength == 2 && take("+"))
      a += b();
    else if (strength == 2 && take("-"))
      a -= b();
    else if (strength == 3 && take("MOD")) {
      const double d = b();
      a = std::fmod(a, d);
      if (a < 0) a += std::abs(d);
    } else if (strength == 3 && take("/"))
      a /= b();
    else if (strength == 3 && !(end_ - p_ > 1 && p_[1] == '*') && take("*"))
      a *= b();
    else if (strength == 4 && take("**"))
      a = std::pow(a, b());
    else
      return a;
    if (!std::isfinite(a)) reject(where, "the result is no number");
  }
}

}  // namespace lightmill::detail
