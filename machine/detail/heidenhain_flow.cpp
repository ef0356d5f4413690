// Heidenhain conversational: Q parameters, labels and jumps.
#include "machine/detail/heidenhain_reader.h"

namespace lightmill::detail {

namespace {

constexpr std::size_t kDeepestCall = 8;
constexpr int kMostQ = 1999;

bool is_digit(char c) {
  return c >= '0' && c <= '9';
}

}  // namespace

/// Of the cursor: within the word that it stands in or behind.
int HeidenhainReader::column() const {
  const auto behind =
      std::find_if(tokens_.begin(), tokens_.end(), [&](const Token& token) { return token.text.data() > p_; });
  const Token& token = behind == tokens_.begin() ? tokens_.front() : *(behind - 1);
  return token.column + static_cast<int>(p_ - token.text.data());
}

void HeidenhainReader::read_from(std::size_t token) {
  if (token >= tokens_.size()) incomplete();
  p_ = tokens_[token].text.data();
  end_ = tokens_.back().text.data() + tokens_.back().text.size();
}

bool HeidenhainReader::operand(double& v, int) {
  if (take("PI")) {
    v = kPi;
    return true;
  }
  if (*p_ != 'Q') return false;
  const int where = column();
  const auto found = q_.find(q_number());
  if (found == q_.end()) reject(where, "this Q parameter was never set");
  v = found->second;
  return true;
}

int HeidenhainReader::q_number() {
  const int where = column();
  double n = 0;
  if (!take("Q") || p_ == end_ || !is_digit(*p_) || !read_digits(p_, end_, n))
    reject(where, "a Q parameter expected, such as Q5; QL, QR and QS are not known here");
  if (n != std::floor(n) || n > kMostQ) reject(where, "Q parameters are numbered from 0 to 1999");
  return static_cast<int>(n);
}

double HeidenhainReader::number(std::string_view text, int column) {
  const std::size_t sign = !text.empty() && (text[0] == '+' || text[0] == '-') ? 1 : 0;
  if (text.size() <= sign || text[sign] != 'Q') return signed_number(text, column);
  p_ = text.data() + sign;
  end_ = text.data() + text.size();
  double v = 0;
  static_cast<void>(operand(v, 0));
  if (p_ != end_) reject(column, "bad number format");
  return text[0] == '-' ? -v : v;
}

/// Q1 = Q2 + 3 * SIN( Q4 )
void HeidenhainReader::formula() {
  read_from(0);
  const int q = q_number();
  skip_blanks();
  if (!take("=")) reject(column(), "'=' is missing");
  const double v = expression();
  skip_blanks();
  if (p_ != end_) reject(column(), "nothing may follow a formula");
  q_[q] = v;
}

/// FN 0 to FN 14.
void HeidenhainReader::fn() {
  read_from(1);
  const int where = column();
  double code = -1;
  if (!read_digits(p_, end_, code) || code != std::floor(code) || code > 99 || !take(":"))
    reject(where, "FN, its number and a colon expected");
  skip_blanks();
  const int number = static_cast<int>(code);
  if (number >= 9 && number <= 12) return fn_jump(number);
  if (number == 14) {
    if (!take("ERROR")) reject(column(), "ERROR is missing");
    reject(where, "the program raises an error of its own, FN 14");
  }
  static constexpr std::string_view kWords[] = {"", "+", "-", "*", "DIV", "SQRT", "SIN", "COS", "LEN"};
  if (number > 8 && number != 13) reject(where, "FN " + std::to_string(number) + " is not understood");
  const int q = q_number();
  skip_blanks();
  if (!take("=")) reject(column(), "'=' is missing");
  skip_blanks();
  const std::string_view word = number == 13 ? "ANG" : kWords[number];
  const bool unary = number >= 5 && number <= 7;
  const auto need_word = [&] {
    skip_blanks();
    if (!take(word)) reject(column(), "FN " + std::to_string(number) + " needs " + std::string(word));
  };
  if (unary) need_word();
  const double a = value();
  double b = 0;
  if (!unary && number != 0) {
    need_word();
    b = value();
  }
  skip_blanks();
  if (p_ != end_) reject(column(), "nothing may follow this function's values");
  const double results[] = {a, a + b, a - b, a * b, a / b, std::sqrt(a), sine(a), cosine(a), std::hypot(a, b)};
  double v = number == 13 ? arc_tangent(a, b) : results[number];
  if (number == 13 && v < 0) v += 360;
  if (!std::isfinite(v)) reject(where, "the result is no number");
  q_[q] = v;
}

/// FN 9: IF +Q1 EQU +Q2 GOTO LBL 5; NE, GT, LT with 10, 11, 12.
void HeidenhainReader::fn_jump(int code) {
  static constexpr std::string_view kRelations[] = {"EQU", "NE", "GT", "LT"};
  if (!take("IF")) reject(column(), "IF is missing");
  const double a = value();
  skip_blanks();
  const std::string_view relation = kRelations[code - 9];
  if (!take(relation)) reject(column(), "FN " + std::to_string(code) + " needs " + std::string(relation));
  const double b = value();
  skip_blanks();
  if (!take("GOTO")) reject(column(), "GOTO is missing");
  skip_blanks();
  if (!take("LBL")) reject(column(), "LBL is missing");
  skip_blanks();
  const std::string_view wanted(p_, static_cast<std::size_t>(end_ - p_));
  const bool holds = code == 9 ? a == b : code == 10 ? a != b : code == 11 ? a > b : a < b;
  if (holds) jump_to(wanted, column());
}

void HeidenhainReader::jump_to(std::string_view wanted, int column) {
  const auto found = labels_.find(wanted);
  if (found == labels_.end()) reject(column, "label " + std::string(wanted) + " is not set");
  next_ = found->second + 1;
}

void HeidenhainReader::label() {
  if (tokens_.size() != 2) incomplete();
  if (tokens_[1].text == "0" && !calls_.empty()) {
    next_ = calls_.back();
    calls_.pop_back();
  }
}

void HeidenhainReader::call() {
  if (is(1, "PGM")) reject(tokens_[1].column, "CALL PGM wants another file: put its blocks behind a label");
  if (!is(1, "LBL") || tokens_.size() < 3 || tokens_.size() > 5) incomplete();
  if (tokens_.size() > 3) {
    // REP2, and REP 2/2 as older controls write it.
    std::string_view text = tokens_[3].text;
    if (!text.starts_with("REP")) expect_end(3);
    text = tokens_.size() == 5 && text == "REP" ? tokens_[4].text.substr(0, tokens_[4].text.find('/')) : text.substr(3);
    if (tokens_.size() == 5 && !is(3, "REP")) expect_end(4);
    const double wanted = number(text, tokens_[3].column);
    if (!(wanted >= 1 && wanted <= 65534)) reject(tokens_[3].column, "REP counts from 1 to 65534");
    auto& left = repeats_.try_emplace(at_, static_cast<long>(wanted)).first->second;
    if (left-- > 0)
      jump_to(tokens_[2].text, tokens_[2].column);
    else
      repeats_.erase(at_);
    return;
  }
  if (calls_.size() >= kDeepestCall) reject(tokens_[0].column, "subprograms nested too deeply");
  const std::size_t back = next_;
  jump_to(tokens_[2].text, tokens_[2].column);
  calls_.push_back(back);
}

}  // namespace lightmill::detail
