// One random program in the words of five controls: it must mean the same to all of them, and what it means in C++.
#include <gtest/gtest.h>
#include <rapidcheck.h>

#include "reader_rig.h"

namespace lightmill {
namespace {

using test::read;
using test::Reading;

/// A value of at most 9: a number, a variable, or half a sum or difference.
struct Value {
  enum Kind : std::uint8_t { kNumber, kVariable, kHalfSum, kHalfDifference, kAbsolute } kind = kNumber;
  int number = 0;
  std::vector<Value> parts;
};

struct Statement {
  enum Kind : std::uint8_t { kSet, kMove, kLoop, kBranch } kind = kMove;
  int number = 0;  ///< variable, or how often
  Value value, other;
  std::vector<Statement> body, otherwise;
};

Value any_value(int depth) {
  Value v;
  v.kind = static_cast<Value::Kind>(*rc::gen::inRange(0, depth > 0 ? 5 : 2));
  v.number = *rc::gen::inRange(0, v.kind == Value::kVariable ? 4 : 10);
  const int parts = v.kind == Value::kAbsolute ? 1 : v.kind > Value::kVariable ? 2 : 0;
  for (int i = 0; i < parts; ++i) v.parts.push_back(any_value(depth - 1));
  return v;
}

std::vector<Statement> any_statements(int depth) {
  std::vector<Statement> all;
  for (int n = *rc::gen::inRange(1, 5); n > 0; --n) {
    Statement s;
    s.kind = static_cast<Statement::Kind>(*rc::gen::inRange(0, depth > 0 ? 4 : 2));
    s.number = s.kind == Statement::kLoop ? *rc::gen::inRange(1, 4) : *rc::gen::inRange(0, 4);
    s.value = any_value(3);
    s.other = any_value(1);
    if (s.kind >= Statement::kLoop) s.body = any_statements(depth - 1);
    if (s.kind == Statement::kBranch) s.otherwise = any_statements(depth - 1);
    all.push_back(std::move(s));
  }
  return all;
}

// --- What it means ---

double meaning(const Value& v, const std::array<double, 4>& variables) {
  const auto part = [&](std::size_t i) { return meaning(v.parts[i], variables); };
  switch (v.kind) {
    case Value::kNumber:
      return v.number;
    case Value::kVariable:
      return variables[static_cast<std::size_t>(v.number)];
    case Value::kHalfSum:
      return (part(0) + part(1)) / 2;
    case Value::kHalfDifference:
      return (part(0) - part(1)) / 2;
    default:
      return std::abs(part(0));
  }
}

void run(const std::vector<Statement>& all, std::array<double, 4>& variables, std::vector<double>& places) {
  for (const Statement& s : all) {
    switch (s.kind) {
      case Statement::kSet:
        variables[static_cast<std::size_t>(s.number)] = meaning(s.value, variables);
        break;
      case Statement::kMove:
        places.push_back(meaning(s.value, variables));
        break;
      case Statement::kLoop:
        for (int i = 0; i < s.number; ++i) run(s.body, variables, places);
        break;
      case Statement::kBranch:
        run(meaning(s.value, variables) < meaning(s.other, variables) ? s.body : s.otherwise, variables, places);
        break;
    }
  }
}

// --- How the controls write it ---

class Writer {
 public:
  explicit Writer(ReaderDialect dialect) : dialect_(dialect) {}

  std::string program(const std::vector<Statement>& all) {
    if (dialect_ == ReaderDialect::kFanuc) line("O1");
    if (dialect_ == ReaderDialect::kHeidenhain) line("BEGIN PGM A MM");
    if (iso()) text_ = "%A G71 *\n";
    if (dialect_ == ReaderDialect::kSiemens) line("G90 G54");
    for (int i = 0; i < 4; ++i) set(i, "0");
    write(all, 1);
    line(dialect_ == ReaderDialect::kHeidenhain ? "END PGM A MM" : iso() ? "%A G71" : "M30");
    return text_;
  }

 private:
  void line(const std::string& block) {
    if (iso()) text_ += "N";
    if (iso() || dialect_ == ReaderDialect::kHeidenhain) text_ += std::to_string(blocks_++) + " ";
    text_ += block + (iso() ? " *\n" : "\n");
  }
  [[nodiscard]] bool iso() const { return dialect_ == ReaderDialect::kHeidenhainIso; }
  [[nodiscard]] bool square() const {
    return dialect_ == ReaderDialect::kFanuc || dialect_ == ReaderDialect::kLinuxCnc;
  }
  [[nodiscard]] std::string in_brackets(const std::string& inside) const {
    return square() ? "[" + inside + "]" : "(" + inside + ")";
  }
  [[nodiscard]] std::string variable(int n) const {
    return (square() ? "#" : dialect_ == ReaderDialect::kSiemens ? "R" : "Q") + std::to_string(101 + n);
  }
  void set(int n, const std::string& value) {
    line(variable(n) + (dialect_ == ReaderDialect::kHeidenhain ? " = " : "=") + value);
  }
  /// A whole expression, in brackets where the control wants them.
  [[nodiscard]] std::string written(const Value& v) const {
    const auto part = [&](std::size_t i) { return written(v.parts[i]); };
    switch (v.kind) {
      case Value::kNumber:
        return std::to_string(v.number);
      case Value::kVariable:
        return variable(v.number);
      case Value::kHalfSum:
        return in_brackets(in_brackets(part(0) + " + " + part(1)) + " / 2");
      case Value::kHalfDifference:
        return in_brackets(in_brackets(part(0) + " - " + part(1)) + " / 2");
      default:
        return "ABS" + in_brackets(part(0));
    }
  }
  void move(const Value& v) {
    switch (dialect_) {
      case ReaderDialect::kHeidenhain:
        set(90, written(v));
        return line("L X+" + variable(90) + " FMAX");
      case ReaderDialect::kHeidenhainIso:
        set(90, written(v));
        return line("G00 X+" + variable(90));
      case ReaderDialect::kSiemens:
        return line("G0 X=" + written(v));
      default:
        return line("G0 X" + in_brackets(written(v)));
    }
  }

  void write(const std::vector<Statement>& all, int depth) {
    for (const Statement& s : all) {
      if (s.kind == Statement::kSet) set(s.number, written(s.value));
      if (s.kind == Statement::kMove) move(s.value);
      if (s.kind == Statement::kLoop) loop(s, depth);
      if (s.kind == Statement::kBranch) branch(s, depth);
    }
  }

  // Heidenhain's.
  void label(const std::string& name) { line((iso() ? "G98 L" : "LBL ") + name); }
  void jump_if_less(const std::string& a, const std::string& b, const std::string& name) {
    line(iso() ? "D12 P01 " + a + " P02 " + b + " P03 " + name : "FN 12: IF " + a + " LT " + b + " GOTO LBL " + name);
  }

  void loop(const Statement& s, int depth) {
    const std::string counter = variable(10 + depth), times = std::to_string(s.number), name = std::to_string(++names_);
    switch (dialect_) {
      case ReaderDialect::kFanuc:
        line(counter + "=0");
        line("WHILE[" + counter + " LT " + times + "]DO" + std::to_string(depth));
        write(s.body, depth + 1);
        line(counter + "=" + counter + "+1");
        return line("END" + std::to_string(depth));
      case ReaderDialect::kLinuxCnc:
        line("o" + name + " repeat [" + times + "]");
        write(s.body, depth + 1);
        return line("o" + name + " endrepeat");
      case ReaderDialect::kSiemens:
        line("FOR " + counter + "=1 TO " + times);
        write(s.body, depth + 1);
        return line("ENDFOR");
      default:
        set(10 + depth, "0");
        label(name);
        set(10 + depth, counter + " + 1");
        write(s.body, depth + 1);
        return jump_if_less("+" + counter, "+" + times, name);
    }
  }

  void branch(const Statement& s, int depth) {
    const std::string a = written(s.value), b = written(s.other);
    const std::string first = std::to_string(++names_), second = std::to_string(++names_);
    switch (dialect_) {
      case ReaderDialect::kFanuc:
        line("IF[" + a + " GE " + b + "]GOTO" + first);
        write(s.body, depth + 1);
        line("GOTO " + second);
        line("N" + first);
        write(s.otherwise, depth + 1);
        return line("N" + second);
      case ReaderDialect::kLinuxCnc:
        line("o" + first + " if [" + a + " lt " + b + "]");
        write(s.body, depth + 1);
        line("o" + first + " else");
        write(s.otherwise, depth + 1);
        return line("o" + first + " endif");
      case ReaderDialect::kSiemens:
        line("IF " + a + " < " + b);
        write(s.body, depth + 1);
        line("ELSE");
        write(s.otherwise, depth + 1);
        return line("ENDIF");
      default:
        set(91, a);
        set(92, b);
        jump_if_less("+" + variable(91), "+" + variable(92), first);
        write(s.otherwise, depth + 1);
        jump_if_less("+0", "+1", second);
        label(first);
        write(s.body, depth + 1);
        return label(second);
    }
  }

  ReaderDialect dialect_;
  std::string text_;
  int blocks_ = 0, names_ = 0;
};

TEST(ProgramReaderLanguages, OneProgramMeansTheSameToAll) {
  EXPECT_TRUE(rc::check("places of a random program", [] {
    const std::vector<Statement> all = any_statements(3);
    std::array<double, 4> variables{};
    std::vector<double> places;
    run(all, variables, places);
    for (const ReaderDialect dialect : {ReaderDialect::kLinuxCnc, ReaderDialect::kFanuc, ReaderDialect::kHeidenhain,
                                        ReaderDialect::kHeidenhainIso, ReaderDialect::kSiemens}) {
      const std::string text = Writer(dialect).program(all);
      RC_LOG() << text;
      const Reading r = read(text, dialect);
      if (r.result.error) RC_LOG() << r.result.error->line << ": " << r.result.error->rule;
      RC_ASSERT(!r.result.error);
      RC_ASSERT(r.moves.size() == places.size());
      for (std::size_t i = 0; i < places.size(); ++i) RC_ASSERT(std::abs(r.moves[i].programmed[0] - places[i]) < 1e-9);
    }
  }));
}

}  // namespace
}  // namespace lightmill
