// Siemens 840D: variables, jumps, loops and subprograms of the same file.
#include "machine/detail/siemens_reader.h"

namespace lightmill::detail {

namespace {

constexpr std::size_t kDeepestCall = 11;
constexpr std::size_t kNowhere = static_cast<std::size_t>(-1);

bool is_jump(std::string_view word) {
  return word == "GOTOF" || word == "GOTOB" || word == "GOTO";
}

/// What a structure's word closes; empty: nothing.
std::string_view opener_of(std::string_view word) {
  static constexpr std::pair<std::string_view, std::string_view> kPairs[] = {
      {"ENDWHILE", "WHILE"}, {"ENDFOR", "FOR"}, {"ENDLOOP", "LOOP"}, {"UNTIL", "REPEAT"}};
  for (const auto& [end, begin] : kPairs) {
    if (word == end) return begin;
  }
  return {};
}

bool is_opener(std::string_view word) {
  return word == "IF" || word == "WHILE" || word == "FOR" || word == "LOOP" || word == "REPEAT";
}

}  // namespace

/// Where labels, structures and subprograms stand; never an error.
void SiemensReader::look_through() {
  if (looked_through_) return;
  looked_through_ = true;
  partners_.assign(lines_.size(), kNowhere);
  const std::string text = text_;
  const auto offset = p_ - text_.data();
  std::vector<std::pair<std::string, std::size_t>> open;
  for (std::size_t i = 0; i < lines_.size(); ++i) {
    text_ = lines_[i].substr(0, lines_[i].find(';'));
    for (char& c : text_) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
    p_ = text_.data();
    end_ = p_ + text_.size();
    skip_blanks();
    if (take("%_N_")) {
      std::string_view program = name();
      const bool sub = program.ends_with("_SPF");
      if (sub) subprograms_.emplace(program.substr(0, program.size() - 4), i);
      sections_.push_back(i);
      open.clear();
      continue;
    }
    if (const std::string_view word = name(); word.size() > 1 && word[0] == 'N' && word[1] >= '0' && word[1] <= '9') {
      labels_[std::string(word)].push_back(i);
      p_ += word.size();
      skip_blanks();
    }
    if (const std::string_view word = name(); word.size() > 1 && p_ + word.size() != end_ && p_[word.size()] == ':') {
      labels_[std::string(word)].push_back(i);
      p_ += word.size() + 1;
      skip_blanks();
    }
    const std::string word(name());
    if (word == "PROC") {
      take_name(word);
      skip_blanks();
      subprograms_.insert_or_assign(std::string(name()), i);  // behind a %_N_ of the same name
      sections_.push_back(i);
      open.clear();
    } else if (is_opener(word)) {
      if (word != "IF" || text_.find("GOTO") == std::string::npos) open.emplace_back(word, i);
    } else if (!open.empty() && word == "ELSE" && open.back().first == "IF") {
      partners_[open.back().second] = i;
      open.back() = {"ELSE", i};
    } else if (!open.empty() && word == "ENDIF" && (open.back().first == "IF" || open.back().first == "ELSE")) {
      partners_[open.back().second] = i;
      open.pop_back();
    } else if (!open.empty() && !opener_of(word).empty() && open.back().first == opener_of(word)) {
      partners_[open.back().second] = i;
      partners_[i] = open.back().second;
      open.pop_back();
    }
  }
  text_ = text;
  p_ = text_.data() + offset;
  end_ = text_.data() + text_.size();
}

std::size_t SiemensReader::partner_of(int where) const {
  if (partners_[at_] == kNowhere) reject(where, "this part of a structure has no other end");
  return partners_[at_];
}

/// A block that is no motion but a statement; false if it is none.
bool SiemensReader::statement() {
  const int where = column();
  const std::string word(name());
  if (*p_ == '%' || word == "PROC") {
    if (began_) reject(where, "the program before this one does not end");
    return began_ = true;
  }
  began_ = true;
  if (word.empty()) return false;
  if (word == "DEF") {
    define_variables();
  } else if (is_jump(word)) {
    jump(true);
  } else if (is_opener(word) || !opener_of(word).empty() || word == "ELSE" || word == "ENDIF") {
    look_through();
    branch(word);
  } else if (word == "RET") {
    take_name(word);
    leave_program(17);
  } else if (word == "CYCLE800") {
    take_name(word);
    swivel();
  } else if (!read_frame() && !cycle_call() && !assignment()) {
    const bool l_call = word.size() > 1 && word[0] == 'L' && word[1] >= '0' && word[1] <= '9';
    if (!l_call && (word.size() < 2 || (word[1] >= '0' && word[1] <= '9'))) return false;
    look_through();
    const auto sub = subprograms_.find(word);
    if (sub == subprograms_.end()) {
      if (l_call) reject(where, "subprogram " + word + " is not in this file");
      return false;
    }
    take_name(word);
    call(sub->second, where);
  }
  skip_blanks();
  if (p_ != end_ && *p_ != ';') reject(column(), "nothing may follow this statement");
  return true;
}

/// A variable at the cursor to be set; none if there stands something else.
SiemensReader::Variable* SiemensReader::variable(int depth) {
  if (*p_ == 'R' && p_ + 1 != end_ && ((p_[1] >= '0' && p_[1] <= '9') || p_[1] == '[')) {
    const int where = column();
    ++p_;
    double n = 0;
    if (take("[")) {
      n = expression(depth);
      if (!take("]")) reject(column(), "']' is missing");
    } else if (!read_digits(p_, end_, n)) {
      reject(column(), "bad number format");
    }
    if (!(n >= 0 && n <= 32535) || n != std::floor(n)) reject(where, "R parameters are numbered from 0 to 32535");
    return &r_[static_cast<int>(n)];
  }
  const auto found = variables_.find(name());
  if (found == variables_.end()) return nullptr;
  p_ += found->first.size();
  return &found->second;
}

/// INT takes the nearest whole number.
void SiemensReader::assign(Variable& variable) {
  const double v = expression();
  variable.value = variable.whole ? std::round(v) : v;
}

bool SiemensReader::assignment() {
  bool any = false;
  for (skip_blanks(); p_ != end_ && *p_ != ';'; skip_blanks()) {
    Variable* const target = variable();
    if (target == nullptr) {
      if (any) reject(column(), "assignments stand in a block of their own");
      return false;
    }
    skip_blanks();
    if (!take("=")) reject(column(), "'=' is missing");
    assign(*target);
    any = true;
  }
  return any;
}

std::string SiemensReader::new_name() {
  skip_blanks();
  const std::string_view wanted = name();
  if (wanted.size() < 2 || (wanted[1] >= '0' && wanted[1] <= '9'))
    reject(column(), "a variable's name begins with two letters");
  p_ += wanted.size();
  return std::string(wanted);
}

bool SiemensReader::type_is_whole() {
  skip_blanks();
  if (take_name("INT") || take_name("BOOL")) return true;
  if (!take_name("REAL")) reject(column(), "variables are understood as REAL, INT and BOOL");
  return false;
}

/// DEF REAL LENGTH, WIDTH=5
void SiemensReader::define_variables() {
  take_name("DEF");
  const bool whole = type_is_whole();
  do {
    const std::string known = new_name();
    skip_blanks();
    Variable v{0, whole};
    if (take("=")) assign(v);
    if (!variables_.emplace(known, v).second) reject(column(), "variable " + known + " is defined already");
    skip_blanks();
  } while (take(","));
}

void SiemensReader::branch(const std::string& word) {
  const int where = column();
  take_name(word);
  if (word == "IF") {
    const bool holds = expression() != 0;
    skip_blanks();
    if (is_jump(name())) return jump(holds);
    if (!holds) next_ = partner_of(where) + 1;
  } else if (word == "ELSE") {
    next_ = partner_of(where) + 1;
  } else if (word == "WHILE") {
    if (expression() == 0) next_ = partner_of(where) + 1;
  } else if (word == "UNTIL") {
    if (expression() == 0) next_ = partner_of(where);
  } else if (word == "FOR") {
    skip_blanks();
    Variable* const counter = variable();
    if (counter == nullptr) reject(column(), "FOR needs a variable");
    skip_blanks();
    if (!take("=")) reject(column(), "'=' is missing");
    const double first = expression();
    skip_blanks();
    if (!take_name("TO")) reject(column(), "FOR needs TO");
    const double last = expression();
    counter->value = counted_ == at_ ? counter->value + 1 : first;
    counted_.reset();
    if (counter->value > last) next_ = partner_of(where) + 1;
  } else if (word == "ENDFOR" || word == "ENDWHILE" || word == "ENDLOOP") {
    next_ = partner_of(where);
    if (word == "ENDFOR") counted_ = next_;
  } else if (word == "LOOP" || word == "REPEAT") {
    static_cast<void>(partner_of(where));
  }
}

/// GOTOF forwards, GOTOB backwards, GOTO forwards and then backwards: to a label or a block number of this program.
void SiemensReader::jump(bool holds) {
  look_through();
  const std::string how(name());
  take_name(how);
  skip_blanks();
  const int where = column();
  const std::string label(name());
  take_name(label);
  if (label.empty()) reject(where, "a label is missing");
  if (!holds) return;
  const auto after = std::upper_bound(sections_.begin(), sections_.end(), at_);
  const std::size_t first = after == sections_.begin() ? 0 : after[-1];
  const std::size_t last = after == sections_.end() ? lines_.size() : *after;
  std::size_t forwards = kNowhere, backwards = kNowhere;
  if (const auto found = labels_.find(label); found != labels_.end()) {
    const auto here = std::upper_bound(found->second.begin(), found->second.end(), at_);
    if (here != found->second.end() && *here < last) forwards = *here;
    if (here != found->second.begin() && here[-1] >= first) backwards = here[-1];
  }
  const std::size_t line = how == "GOTOF" ? forwards : how == "GOTOB" || forwards == kNowhere ? backwards : forwards;
  if (line == kNowhere) reject(where, "label " + label + " is not found in this direction");
  next_ = line;
}

/// (8, , 2): what is left out is empty.
std::vector<std::optional<double>> SiemensReader::arguments() {
  std::vector<std::optional<double>> values;
  if (!take("(")) reject(column(), "'(' is missing");
  for (skip_blanks(); !take(")"); skip_blanks()) {
    if (p_ == end_) reject(column(), "')' is missing");
    std::optional<double>& value = values.emplace_back();
    if (*p_ != ',' && *p_ != ')') value = expression();
    skip_blanks();
    if (p_ != end_ && *p_ != ')' && !take(",")) reject(column(), "',' or ')' expected");
  }
  return values;
}

/// PROC NAME(REAL RADIUS, INT COUNT=2): the parameters are the subprogram's own until it ends.
void SiemensReader::take_arguments(std::size_t line, Call& call, int where) {
  const std::vector<std::optional<double>> values = p_ != end_ && *p_ == '(' ? arguments() : decltype(arguments()){};
  const std::string text = text_;
  const auto offset = p_ - text_.data();
  text_ = lines_[line].substr(0, lines_[line].find(';'));
  for (char& c : text_) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  p_ = text_.data() + std::min(text_.find('('), text_.size());
  end_ = text_.data() + text_.size();
  std::size_t count = 0;
  if (take("(")) {
    for (skip_blanks(); !take(")"); skip_blanks()) {
      if (p_ == end_) reject(where, "the subprogram's list of parameters does not end");
      Variable parameter{0, type_is_whole()};
      const std::string known = new_name();
      skip_blanks();
      if (take("=")) assign(parameter);
      if (count < values.size() && values[count]) parameter.value = *values[count];
      if (parameter.whole) parameter.value = std::round(parameter.value);
      ++count;
      const auto old = variables_.find(known);
      call.hidden.emplace_back(known, old == variables_.end() ? std::nullopt : std::optional(old->second));
      variables_[known] = parameter;
      skip_blanks();
      if (p_ != end_ && *p_ != ')' && !take(",")) reject(where, "the subprogram's parameters stand apart by commas");
    }
  }
  text_ = text;
  p_ = text_.data() + offset;
  end_ = text_.data() + text_.size();
  if (values.size() > count) reject(where, "more values than the subprogram has parameters");
}

/// L10 P3: a program of this file, three times. POCKET(8): with values for its parameters.
void SiemensReader::call(std::size_t line, int where) {
  skip_blanks();
  double times = 1;
  if (calls_.size() >= kDeepestCall) reject(where, "subprograms nested too deeply");
  Call call{next_, line + 1, 0, {}};
  take_arguments(line, call, where);
  skip_blanks();
  if (take("P")) times = address_value();
  if (!(times >= 1 && times <= 9999) || times != std::floor(times)) reject(column(), "P counts from 1 to 9999");
  call.left = static_cast<long>(times) - 1;
  calls_.push_back(std::move(call));
  next_ = line + 1;
}

/// M2, M30 anywhere, M17 and RET at the end of a subprogram.
void SiemensReader::leave_program(int code) {
  if (code == 17 && !calls_.empty()) {
    Call& back = calls_.back();
    if (back.left-- > 0) {
      next_ = back.start;
      return;
    }
    next_ = back.back;
    for (auto hidden = back.hidden.rbegin(); hidden != back.hidden.rend(); ++hidden) {
      if (hidden->second)
        variables_[hidden->first] = *hidden->second;
      else
        variables_.erase(hidden->first);
    }
    calls_.pop_back();
    return;
  }
  refuse_inside_contour();
  path_.stop();
  core_.say(ProgramStep::kEnd, code);
  ended_ = true;
}

}  // namespace lightmill::detail
