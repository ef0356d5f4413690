// Expressions in machine programs: one evaluator, told by a grammar how a dialect writes brackets, operators and
// functions.
#pragma once

#include <span>
#include <string_view>

namespace lightmill::detail {

struct Grammar {
  struct Operator {
    std::string_view word;
    int strength;  ///< 0 binds least; equal ones from left to right
    double (*apply)(double, double);
  };
  struct Function {
    std::string_view name;
    double (*apply)(double);
  };
  struct PairFunction {
    std::string_view name;
    double (*apply)(double, double);
  };
  char open, close;
  int strengths;
  std::span<const Operator> operators;
  std::span<const Function> functions;
  std::span<const PairFunction> pair_functions;  ///< of two arguments with a comma between
  bool blanks = false;                           ///< may stand inside an expression
  bool bare_arguments = false;                   ///< a function's argument needs no brackets
};

/// Of degrees.
double sine(double degrees);
double cosine(double degrees);
double tangent(double degrees);
double arc_sine(double x);
double arc_cosine(double x);
double arc_tangent(double y, double x);

/// Reads values at a cursor, which it moves; a dialect's reader derives from it.
class ExpressionReader {
 protected:
  explicit ExpressionReader(const Grammar& grammar) : grammar_(&grammar) {}
  virtual ~ExpressionReader() = default;
  ExpressionReader(const ExpressionReader&) = delete;
  ExpressionReader& operator=(const ExpressionReader&) = delete;

  [[nodiscard]] virtual int column() const = 0;
  /// What only this dialect knows, such as a parameter; false if nothing of the kind stands at the cursor.
  virtual bool operand(double& v, int depth) = 0;

  bool take(std::string_view word) {
    if (!std::string_view(p_, static_cast<std::size_t>(end_ - p_)).starts_with(word)) return false;
    p_ += word.size();
    return true;
  }
  void skip_blanks() {
    while (p_ != end_ && (*p_ == ' ' || *p_ == '\t')) ++p_;
  }
  /// A signed number, parameter, function or bracket.
  double value(int depth = 0);
  double bracket(int depth = 0);
  /// A whole expression without brackets around it.
  double expression(int depth = 0) { return level(0, depth); }

  const char *p_ = nullptr, *end_ = nullptr;
  bool point_ = false;  ///< the last value was written with a point, or reckoned

 private:
  double level(int strength, int depth);
  double function(int depth);
  void expect(char c);
  const Grammar* grammar_;
};

}  // namespace lightmill::detail
