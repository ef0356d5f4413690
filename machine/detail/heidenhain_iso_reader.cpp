// Heidenhain DIN/ISO: each block means what its blocks in the conversational language mean, and is read as those.
#include "machine/detail/heidenhain_reader.h"

namespace lightmill::detail {

namespace {

constexpr std::size_t kMostTranslated = 2048;

bool is_number_behind(std::string_view text, char letter) {
  return text.size() > 1 && text[0] == letter && text[1] >= '0' && text[1] <= '9';
}

}  // namespace

/// The words of a DIN/ISO block, sorted.
struct HeidenhainReader::IsoWords {
  std::vector<int> g;
  std::vector<Token> axes, m, deltas, parameters;  ///< deltas: DL, DR; parameters: Q200=+2 of cycles
  std::optional<Token> i, j, r, h, f, s, t, l;

  [[nodiscard]] bool has(int code) const { return std::find(g.begin(), g.end(), code) != g.end(); }
  [[nodiscard]] int cycle() const {
    const auto found = std::find_if(g.begin(), g.end(), [](int code) { return code >= 200; });
    return found == g.end() ? 0 : *found;
  }
};

/// Reads what add() has put together as a block.
void HeidenhainReader::read_added() {
  tokens_ = added_;
  added_.clear();
  read_block();
  translated_.clear();
}

void HeidenhainReader::add(std::string_view before, std::string_view text, int column) {
  if (translated_.size() + before.size() + text.size() + 1 > kMostTranslated) reject(column, "block too long");
  translated_.reserve(kMostTranslated);  // so that the views stay
  const std::size_t at = translated_.size();
  translated_.append(before).append(text);
  added_.push_back({std::string_view(translated_).substr(at), column});
  translated_ += ' ';
}

void HeidenhainReader::read_iso_block() {
  const std::vector<Token> words = tokens_;
  const Token& first = words[0];
  const int column = first.column;
  if (defining_) return read_block();
  if (first.text[0] == '%') return iso_frame(words);
  if (!begun_) reject(column, "the program must start with % and its name");
  if (is_number_behind(first.text, 'Q')) return read_block();  // a formula
  if (is_number_behind(first.text, 'D')) return iso_function(words);
  if (first.text == "G98") {
    if (words.size() != 2 || words[1].text.size() < 2 || words[1].text[0] != 'L')
      reject(column, "G98 needs its label, L");
    add("", "LBL", column);
    add("", words[1].text.substr(1), words[1].column);
    return read_added();
  }
  if (const std::size_t comma = first.text.find(','); first.text[0] == 'L' && comma != std::string_view::npos) {
    if (words.size() > 1) reject(words[1].column, "nothing may follow a call");
    add("", "CALL", column);
    add("", "LBL", column);
    add("", first.text.substr(1, comma - 1), column);
    const std::string_view times = first.text.substr(comma + 1);
    if (times != "0") add("REP", times, column);
    return read_added();
  }
  IsoWords w;
  for (std::size_t i = 0; i < words.size(); ++i) sort_iso_word(w, words, i);
  iso_cycles(w, column);
}

void HeidenhainReader::iso_frame(const std::vector<Token>& words) {
  if (words.size() != 2 || (words[1].text != "G71" && words[1].text != "G70"))
    reject(words[0].column, "%, the name and G70 or G71 expected");
  const bool begin = !begun_;
  add("", begin ? "BEGIN" : "END", words[0].column);
  add("", "PGM", words[0].column);
  add("", words[0].text, words[0].column);
  add("", words[1].text == "G71" ? "MM" : "INCH", words[1].column);
  read_added();
  if (begin) name_ = words[0].text;
}

/// D00 Q1 P01 +3 to D08, D13; D09 P01 +Q1 P02 +2 P03 5 to D12, whose P03 is a label.
void HeidenhainReader::iso_function(const std::vector<Token>& words) {
  const Token& first = words[0];
  const double code = signed_number(first.text.substr(1), first.column);
  static constexpr std::string_view kBetween[] = {"",    "+",   "-",   "*",  "DIV", "SQRT", "SIN",
                                                  "COS", "LEN", "EQU", "NE", "GT",  "LT",   "ANG"};
  if (code != std::floor(code) || !(code < static_cast<double>(std::size(kBetween))))
    reject(first.column, std::string(first.text) + " is not understood");
  const auto number = static_cast<std::size_t>(code);
  const bool jump = number >= 9 && number <= 12, unary = number >= 5 && number <= 7;
  const std::size_t values = jump ? 3 : unary || number == 0 ? 1 : 2, from = jump ? 1 : 2;
  if (words.size() != from + 2 * values) reject(first.column, "the block is not complete, or has a word too many");
  for (std::size_t i = 0; i < values; ++i) {
    const Token& name = words[from + 2 * i];
    if (name.text != "P0" + std::to_string(i + 1)) reject(name.column, "P0" + std::to_string(i + 1) + " expected");
  }
  const auto value = [&](std::size_t i) { add("", words[from + 2 * i + 1].text, words[from + 2 * i + 1].column); };
  add("", "FN", first.column);
  add(std::to_string(number), ":", first.column);
  if (jump)
    add("", "IF", first.column);
  else
    add(words[1].text, "=", words[1].column);
  if (unary) add("", kBetween[number], first.column);
  value(0);
  if (values > 1) {
    add("", kBetween[number], first.column);
    value(1);
  }
  if (jump) {
    add("", "GOTO", first.column);
    add("", "LBL", first.column);
    value(2);
  }
  read_added();
}

void HeidenhainReader::sort_iso_word(IsoWords& w, const std::vector<Token>& words, std::size_t& i) {
  const Token& token = words[i];
  const std::string_view text = token.text;
  const auto once = [&](std::optional<Token>& word) {
    if (word) reject(token.column, "word named twice");
    word = token;
  };
  if (text.starts_with("P0") && text.size() == 3 && w.has(62)) {  // the mode and the rotary tolerance of G62
    if (++i >= words.size()) reject(token.column, "a value is missing");
    static_cast<void>(number(words[i].text, words[i].column));
    return;
  }
  if (is_number_behind(text, 'Q')) return w.parameters.push_back(token);
  if (text.starts_with("DL") || text.starts_with("DR")) return w.deltas.push_back(token);
  if (core_.axis_of(text[0]) >= 0) return w.axes.push_back(token);
  if (text[0] == 'G') {
    const double code = signed_number(text.substr(1), token.column);
    static constexpr int kKnown[] = {0,  1,  2,  3,  4,  6,  10, 11, 12, 13, 16, 17,  24,  25, 30,
                                     31, 38, 40, 41, 42, 54, 62, 79, 90, 91, 99, 200, 201, 247};
    if (std::find(std::begin(kKnown), std::end(kKnown), code) == std::end(kKnown))
      reject(token.column, std::string(text) + " is not understood");
    return w.g.push_back(static_cast<int>(code));
  }
  switch (text[0]) {
    case 'M':
      return w.m.push_back(token);
    case 'I':
      return once(w.i);
    case 'J':
      return once(w.j);
    case 'R':
      return once(w.r);
    case 'H':
      return once(w.h);
    case 'F':
      return once(w.f);
    case 'S':
      return once(w.s);
    case 'T':
      return once(w.t);
    case 'L':
      return once(w.l);
    default:
      if (w.cycle() != 0 && w.parameters.empty()) return;  // the cycle's name
      reject(token.column, "'" + std::string(text) + "' is not understood");
  }
}

/// What stands for itself; all else goes on to iso_path().
void HeidenhainReader::iso_cycles(const IsoWords& w, int column) {
  const auto begin = [&](std::initializer_list<std::string_view> words) {
    for (const std::string_view word : words) add("", word, column);
  };
  const auto all = [&](const std::vector<Token>& tokens) {
    for (const Token& token : tokens) add("", token.text, token.column);
  };
  if (w.has(30) || w.has(31)) return;  // the blank
  if (w.has(62)) {
    begin({"CYCL", "DEF", "32.1"});
    if (w.t) add("", w.t->text, w.t->column);
    return read_added();
  }
  if (w.has(24) || w.has(25)) {
    if (!w.r) reject(column, "G24 and G25 need their R");
    begin({w.has(24) ? "CHF" : "RND"});
    add("", w.r->text, w.r->column);
    if (w.f) add("", w.f->text, w.f->column);
    return read_added();
  }
  if (w.has(99)) {
    if (!w.t) reject(column, "G99 needs its T");
    begin({"TOOL", "DEF"});
    add("", w.t->text.substr(1), w.t->column);
    for (const auto& word : {w.l, w.r}) {
      if (word) add("", word->text, word->column);
    }
    return read_added();
  }
  if (w.has(4)) {
    if (!w.f) reject(column, "G04 needs its seconds in F");
    begin({"CYCL", "DEF", "9.1"});
    add("DWELL", w.f->text.substr(1), w.f->column);
    return read_added();
  }
  for (const int code : w.g) {
    if (code == 90 || code == 91) iso_incremental_ = code == 91;
  }
  const std::string_view step = iso_incremental_ ? "I" : "";
  if (w.has(54)) {
    begin({"CYCL", "DEF", "7.1"});
    for (const Token& axis : w.axes) add(step, axis.text, axis.column);
    return read_added();
  }
  if (const int cycle = w.cycle(); cycle != 0) {
    begin({"CYCL", "DEF"});
    add("", std::to_string(cycle), column);
    all(w.parameters);
    return read_added();
  }
  if (w.t || w.s) {
    begin({"TOOL", "CALL"});
    if (w.t) {
      if (!w.has(17)) reject(column, "a tool call needs its axis, G17");
      add("", w.t->text.substr(1), w.t->column);
      add("", "Z", column);
    }
    if (w.s) add("", w.s->text, w.s->column);
    all(w.deltas);
    read_added();
  }
  if (w.i || w.j) {
    begin({"CC"});
    if (w.i) add(std::string(step) + "X", w.i->text.substr(1), w.i->column);
    if (w.j) add(std::string(step) + "Y", w.j->text.substr(1), w.j->column);
    read_added();
  }
  if (w.has(38) || w.has(79)) {
    if (w.has(38))
      begin({"STOP"});
    else
      begin({"CYCL", "CALL"});
    all(w.m);
    return read_added();
  }
  iso_path(w, step, column);
}

void HeidenhainReader::iso_path(const IsoWords& w, std::string_view step, int column) {
  std::string_view side;
  for (const int code : w.g) {
    if (code <= 16) iso_motion_ = code;
    if (code >= 40 && code <= 42) side = code == 40 ? "R0" : code == 41 ? "RL" : "RR";
  }
  const bool polar = iso_motion_ >= 10;
  const int kind = iso_motion_ % 10;  // as of G00 to G06
  const bool goes = !w.axes.empty() || (polar && (w.r || w.h));
  if (!goes && side.empty() && !w.f && w.m.empty()) return;
  if (goes || !side.empty() || w.f) {
    std::string_view word = "L";
    if (goes && kind == 6)
      word = polar ? "CTP" : "CT";
    else if (goes && kind > 1)
      word = polar ? "CP" : w.r ? "CR" : "C";
    else if (goes && polar)
      word = "LP";
    add("", word, column);
    for (const Token& axis : w.axes) add(step, axis.text, axis.column);
    if (polar && w.r) add(std::string(step) + "P", w.r->text, w.r->column);
    if (polar && w.h) add(std::string(step) + "PA", w.h->text.substr(1), w.h->column);
    if (word == "CR") add("", w.r->text, w.r->column);
    if (goes && (kind == 2 || kind == 3)) add("DR", kind == 2 ? "-" : "+", column);
    if (!side.empty()) add("", side, column);
    if (goes && kind == 0) add("", "FMAX", column);
    if (w.f) add("", w.f->text, w.f->column);
  }
  for (const Token& m : w.m) add("", m.text, m.column);
  read_added();
}

ReadResult read_heidenhain_iso(std::string_view text, ReaderCore& core) {
  return HeidenhainReader(text, core, true).run();
}

}  // namespace lightmill::detail
