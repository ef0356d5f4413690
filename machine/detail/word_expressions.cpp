// Values of RS274/NGC and Fanuc: numbers, parameters, functions, expressions.
#include "machine/detail/word_reader.h"

namespace lightmill::detail {

namespace {

double modulo(double a, double b) {
  const double r = std::fmod(a, b);
  return r < 0 ? r + std::abs(b) : r;
}

constexpr Grammar::Operator kRs274Operators[] = {
    {"AND", 0, [](double a, double b) { return double(a != 0 && b != 0); }},
    {"XOR", 0, [](double a, double b) { return double((a != 0) != (b != 0)); }},
    {"OR", 0, [](double a, double b) { return double(a != 0 || b != 0); }},
    {"EQ", 1, [](double a, double b) { return double(a == b); }},
    {"NE", 1, [](double a, double b) { return double(a != b); }},
    {"GT", 1, [](double a, double b) { return double(a > b); }},
    {"GE", 1, [](double a, double b) { return double(a >= b); }},
    {"LT", 1, [](double a, double b) { return double(a < b); }},
    {"LE", 1, [](double a, double b) { return double(a <= b); }},
    {"+", 2, [](double a, double b) { return a + b; }},
    {"-", 2, [](double a, double b) { return a - b; }},
    {"MOD", 3, modulo},
    {"/", 3, [](double a, double b) { return a / b; }},
    {"*", 3, [](double a, double b) { return a * b; }},
    {"**", 4, [](double a, double b) { return std::pow(a, b); }}};

constexpr Grammar::Function kRs274Functions[] = {{"ABS", [](double x) { return std::abs(x); }},
                                                 {"ACOS", arc_cosine},
                                                 {"ASIN", arc_sine},
                                                 {"COS", cosine},
                                                 {"EXP", [](double x) { return std::exp(x); }},
                                                 {"FIX", [](double x) { return std::floor(x); }},
                                                 {"FUP", [](double x) { return std::ceil(x); }},
                                                 {"LN", [](double x) { return std::log(x); }},
                                                 {"ROUND", [](double x) { return std::round(x); }},
                                                 {"SIN", sine},
                                                 {"SQRT", [](double x) { return std::sqrt(x); }},
                                                 {"TAN", tangent}};

// Fanuc's empty variables are no numbers: 0 to all but EQ and NE.
double filled(double x) {
  return std::isnan(x) ? 0 : x;
}

bool same(double a, double b) {
  return std::isnan(a) || std::isnan(b) ? std::isnan(a) && std::isnan(b) : a == b;
}

/// Bit by bit; no number where the operands are not whole or out of range.
template <typename Bits>
double bitwise(double a, double b, Bits bits) {
  a = filled(a);
  b = filled(b);
  constexpr double kMost = 2147483647;
  if (a != std::floor(a) || b != std::floor(b) || std::abs(a) > kMost || std::abs(b) > kMost)
    return std::numeric_limits<double>::quiet_NaN();
  return static_cast<double>(bits(static_cast<long>(a), static_cast<long>(b)));
}

constexpr Grammar::Operator kFanucOperators[] = {
    {"EQ", 0, [](double a, double b) { return double(same(a, b)); }},
    {"NE", 0, [](double a, double b) { return double(!same(a, b)); }},
    {"GT", 0, [](double a, double b) { return double(filled(a) > filled(b)); }},
    {"GE", 0, [](double a, double b) { return double(filled(a) >= filled(b)); }},
    {"LT", 0, [](double a, double b) { return double(filled(a) < filled(b)); }},
    {"LE", 0, [](double a, double b) { return double(filled(a) <= filled(b)); }},
    {"+", 1, [](double a, double b) { return filled(a) + filled(b); }},
    {"-", 1, [](double a, double b) { return filled(a) - filled(b); }},
    {"OR", 1, [](double a, double b) { return bitwise(a, b, [](long x, long y) { return x | y; }); }},
    {"XOR", 1, [](double a, double b) { return bitwise(a, b, [](long x, long y) { return x ^ y; }); }},
    {"*", 2, [](double a, double b) { return filled(a) * filled(b); }},
    {"/", 2, [](double a, double b) { return filled(a) / filled(b); }},
    {"MOD", 2, [](double a, double b) { return std::fmod(filled(a), filled(b)); }},
    {"AND", 2, [](double a, double b) { return bitwise(a, b, [](long x, long y) { return x & y; }); }}};

constexpr Grammar::Function kFanucFunctions[] = {{"ABS", [](double x) { return std::abs(filled(x)); }},
                                                 {"ACOS", [](double x) { return arc_cosine(filled(x)); }},
                                                 {"ASIN", [](double x) { return arc_sine(filled(x)); }},
                                                 {"COS", [](double x) { return cosine(filled(x)); }},
                                                 {"EXP", [](double x) { return std::exp(filled(x)); }},
                                                 {"FIX", [](double x) { return std::trunc(filled(x)); }},
                                                 {"FUP",
                                                  [](double x) {
                                                    const double v = filled(x);
                                                    return v < 0 ? std::floor(v) : std::ceil(v);
                                                  }},
                                                 {"LN", [](double x) { return std::log(filled(x)); }},
                                                 {"ROUND", [](double x) { return std::round(filled(x)); }},
                                                 {"SIN", [](double x) { return sine(filled(x)); }},
                                                 {"SQRT", [](double x) { return std::sqrt(filled(x)); }},
                                                 {"TAN", [](double x) { return tangent(filled(x)); }}};

constexpr Grammar kRs274{'[', ']', 5, kRs274Operators, kRs274Functions, {}};
constexpr Grammar kFanuc{'[', ']', 3, kFanucOperators, kFanucFunctions, {}};

}  // namespace

const Grammar& word_grammar(bool fanuc) {
  return fanuc ? kFanuc : kRs274;
}

bool WordReader::operand(double& v, int depth) {
  if (*p_ == '#') {
    v = parameter(depth);
    return true;
  }
  if (take("ATAN")) {
    if (fanuc_ && take("[")) {
      const double y = expression(depth);
      const bool pair = take(",");
      const double x = pair ? expression(depth) : 0;
      if (!take("]")) reject(column(), "']' is missing");
      if (!pair && !take("/")) reject(column(), "ATAN needs [y]/[x]");
      v = arc_tangent(filled(y), filled(pair ? x : bracket(depth)));
      return true;
    }
    const double y = bracket(depth);
    if (!take("/")) reject(column(), "ATAN needs [y]/[x]");
    v = arc_tangent(y, bracket(depth));
    return true;
  }
  if (!fanuc_ && take("EXISTS[#<")) {
    const std::string name = name_end();
    if (!take("]")) reject(column(), "']' is missing");
    v = named(name) != nullptr ? 1 : 0;
    return true;
  }
  return false;
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
  if (fanuc_) return variable(value(depth), where);
  if (take("<")) {
    const std::string name = name_end();
    if (const double* known = named(name)) return *known;
    static constexpr const char* kAxes[] = {"_X", "_Y", "_Z"};
    for (std::size_t i = 0; i < 3; ++i) {
      if (name == kAxes[i]) return (path_.on() ? path_.centre() : path_.place())[i] / unit_;
    }
    if (name == "_METRIC") return unit_ == 1;
    if (name == "_IMPERIAL") return unit_ != 1;
    if (name == "_FEED") return feed_.value / unit_;
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
    if (path_.on()) reject(column(), "the position is not known while cutter compensation is on");
    return path_.place()[static_cast<std::size_t>(n - 5420)] / unit_;
  }
  if (n == 5400) return tool_;
  if (n == 5220) return static_cast<double>(offset_) + 1;
  if (n > 5220 && n < 5400 && (n - 5221) % 20 < 9) {  // G54 to G59.3: X Y Z A B C U V W, in mm and degrees
    const int nth = (n - 5221) % 20, axis = nth < 3 ? nth : core_.axis_of(static_cast<char>('A' + nth - 3));
    if (axis < 0 || nth > 5) return 0;
    const double v = offsets_[static_cast<std::size_t>(n - 5221) / 20][static_cast<std::size_t>(axis)];
    return axis < 3 ? v : v / kRadPerDegree;
  }
  if (n >= 5161 && n < 5220 && numbers_.find(n) == numbers_.end())
    reject(column(), "parameter #" + std::to_string(n) + " is not known here");  // places of G28, G30, G92
  const auto found = numbers_.find(n);
  return found == numbers_.end() ? 0 : found->second;
}

}  // namespace lightmill::detail
