// Heidenhain: cycles. [TNC 640, cycle programming, chapters 4 and 12]
#include "machine/detail/heidenhain_reader.h"

namespace lightmill::detail {

namespace {

constexpr double kMostPecks = 10000;

/// The Q parameters that a cycle takes; those it cannot do without come first.
struct CycleWords {
  int number;
  std::size_t needed;
  std::vector<int> words;
};

const CycleWords* words_of(int number) {
  // 247: datum; 200: drilling with pecks; 201: reaming.
  static const CycleWords kCycles[] = {{247, 1, {339}},
                                       {200, 5, {200, 201, 202, 203, 206, 204, 210, 211, 395}},
                                       {201, 4, {200, 201, 203, 206, 204, 208, 211}}};
  for (const CycleWords& cycle : kCycles) {
    if (cycle.number == number) return &cycle;
  }
  return nullptr;
}

}  // namespace

void HeidenhainReader::cycle() {
  if (is(1, "CALL")) {
    modes(2);
    call_cycle();
    return finish();
  }
  if (!is(1, "DEF") || tokens_.size() < 3) incomplete();
  const std::string_view what = tokens_[2].text;
  if (what == "7.0" || what == "9.0" || what == "32.0") return;  // headings; the values follow
  if (what.starts_with("7.") && what.size() == 3) return datum_shift();
  if (what == "9.1") return dwell();
  if (what == "32.1" || what == "32.2") return tolerance(what == "32.1");
  for (const int number : {200, 201, 247}) {
    if (what == std::to_string(number)) return begin_cycle(number, 3);
  }
  reject(tokens_[2].column, "cycle " + std::string(what) + " is not understood");
}

/// CYCL DEF 200 DRILLING Q200=+2 Q201=-15 ..., in one block or in lines that ~ continues.
void HeidenhainReader::begin_cycle(int number, std::size_t words) {
  refuse_beside_compensation("a cycle");
  defining_ = Cycle{number, {}};
  while (words < tokens_.size() && (tokens_[words].text.size() < 2 || tokens_[words].text[0] != 'Q')) ++words;
  read_cycle_words(words);
}

void HeidenhainReader::read_cycle_words(std::size_t i) {
  if (i < tokens_.size()) {
    read_from(i);
    while (p_ != end_) {
      const int where = column(), q = q_number();
      const std::vector<int>& known = words_of(defining_->number)->words;
      if (std::find(known.begin(), known.end(), q) == known.end())
        reject(where, "cycle " + std::to_string(defining_->number) + " does not know Q" + std::to_string(q));
      skip_blanks();
      if (!take("=")) reject(column(), "'=' is missing");
      defining_->words[q] = q_[q] = value();
      skip_blanks();
    }
  }
  if (!continued_) end_cycle();
}

void HeidenhainReader::end_cycle() {
  const Cycle cycle = *defining_;
  defining_.reset();
  const CycleWords& words = *words_of(cycle.number);
  for (std::size_t i = 0; i < words.needed; ++i) {
    if (cycle.words.find(words.words[i]) == cycle.words.end())
      reject(1, "cycle " + std::to_string(cycle.number) + " needs Q" + std::to_string(words.words[i]));
  }
  if (cycle.number == 247) return preset(cycle.words.at(339), 1);
  cycle_ = cycle;
}

/// The cycle defined last, at the place where the tool stands.
void HeidenhainReader::call_cycle() {
  const int column = tokens_[0].column;
  if (!cycle_) reject(column, "no cycle is defined that could be called");
  refuse_beside_compensation("a cycle");
  const auto word = [&](int q) {
    const auto found = cycle_->words.find(q);
    return found == cycle_->words.end() ? 0.0 : found->second;
  };
  const double surface = word(203) * unit_, clear = surface + word(200) * unit_, depth = -word(201) * unit_,
               feed = word(206) * unit_, peck = cycle_->number == 200 ? word(202) * unit_ : 0;
  if (depth == 0) return;  // so says the manual
  if (!(word(200) >= 0 && depth > 0 && feed > 0 && peck >= 0 && word(204) >= 0 && word(208) >= 0))
    reject(column, "Q201 must be below 0, Q206 above 0, and Q200, Q202, Q204, Q208 not below 0");
  if (word(395) != 0) reject(column, "Q395 other than 0 needs the drill's point angle");
  if (peck > 0 && depth / peck > kMostPecks) reject(column, "Q202 is too small for the depth");
  const auto to = [&](double z, bool rapid, double at_feed) {
    AxisValues place = path_.place();
    place[2] = z;
    path_.straight(place, rapid, {at_feed, false});
  };
  const auto wait = [&](double seconds) {
    if (seconds < 0) reject(column, "negative time");
    if (seconds > 0) path_.say(ProgramStep::kDwell, 0, seconds);
  };
  to(clear, true, feed);
  for (double done = 0; done < depth;) {
    if (done > 0) {
      to(clear, true, feed);
      wait(word(210));
      to(clear - done, true, feed);
    }
    done = peck > 0 ? std::min(done + peck, depth) : depth;
    to(surface - done, false, feed);
  }
  wait(word(211));
  const bool feeds_back = cycle_->number == 201;
  to(clear, !feeds_back, word(208) > 0 ? word(208) * unit_ : feed);
  if (surface + word(204) * unit_ > clear) to(surface + word(204) * unit_, true, feed);
  has_heading_ = false;
}

/// CYCL DEF 7.1 X+5
void HeidenhainReader::datum_shift() {
  if (tokens_.size() < 4 || core_.tcp()) reject(tokens_[0].column, "a datum shift needs an axis and no M128");
  refuse_beside_compensation("cycle 7");
  AxisValues shift = shift_;
  for (std::size_t i = 0; i < 3 && core_.tilted(); ++i) shift[i] = tilted_shift_[static_cast<int>(i)];
  for (std::size_t i = 3; i < tokens_.size(); ++i) {
    if (!axis_word(tokens_[i], shift, shift)) expect_end(i);
  }
  if (core_.tilted())
    tilted_shift_ = {shift[0], shift[1], shift[2]};
  else
    shift_ = shift;
  renew_offset();
}

/// CYCL DEF 9.1 DWELL 0.5
void HeidenhainReader::dwell() {
  if (tokens_.size() < 4) incomplete();
  const Token& last = tokens_.back();
  const double seconds = number(last.text.starts_with("DWELL") ? last.text.substr(5) : last.text, last.column);
  if (seconds < 0) reject(last.column, "negative time");
  path_.say(ProgramStep::kDwell, 0, seconds);
}

/// CYCL DEF 32.1 T0.05, CYCL DEF 32.2 HSC-MODE:1 TA0.5
void HeidenhainReader::tolerance(bool first) {
  if (first) core_.corner_tolerance_mm = -1;
  for (std::size_t i = 3; i < tokens_.size(); ++i) {
    const std::string_view text = tokens_[i].text;
    const std::size_t skip = text.starts_with("HSC-MODE:") ? 9
                             : text.starts_with("TA")      ? 2
                             : text.starts_with("T")       ? 1
                                                           : 0;
    if (skip == 0) expect_end(i);
    const double value = number(text.substr(skip), tokens_[i].column);
    if (first && skip == 1) core_.corner_tolerance_mm = std::max(0.0, value);
  }
}

}  // namespace lightmill::detail
