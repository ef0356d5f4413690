// Which block comes next: O-words, subprograms, and the modes they keep.
#include "machine/detail/word_reader.h"

namespace lightmill::detail {

namespace {
constexpr int kLocals = 30;
}

/// O<name> or O<number> at the line's start; the label, and the cursor behind it.
std::string WordReader::label() {
  if (take("<")) return name_end();
  const double v = value();
  return std::to_string(static_cast<long>(std::clamp(v, -1e9, 1e9)));
}

/// The next line from `from` on with this label and one of the words; the line's number.
std::size_t WordReader::find(std::size_t from, const std::string& wanted, std::initializer_list<std::string_view> words,
                             std::string_view* found) {
  const int where = column();
  const std::string text = text_;
  const std::vector<int> columns = columns_;
  const auto offset = p_ - text_.data();
  for (std::size_t i = from; i < lines_.size(); ++i) {
    const std::size_t first = lines_[i].find_first_not_of(" \t");
    if (++searched_ > core_.setup.most_blocks) reject(where, "the program does not end");
    if (first == std::string_view::npos || (lines_[i][first] | 32) != 'o') continue;
    prepare(lines_[i]);
    ++p_;
    if (p_ != end_ && (*p_ == '#' || *p_ == '[')) continue;
    if (label() != wanted) continue;
    for (const std::string_view word : words) {
      if (!take(word)) continue;
      if (found != nullptr) *found = word;
      const std::size_t line = i;
      if (word != "ELSEIF") {  // whose condition is read next
        text_ = text;
        columns_ = columns;
        p_ = text_.data() + offset;
        end_ = text_.data() + text_.size();
      }
      return line;
    }
  }
  reject(where, "o<" + wanted + "> has no end");
}

void WordReader::leave_sub() {
  Frame& frame = frames_.back();
  loops_.resize(frame.loops);
  if (frame.left > 0) {
    --frame.left;
    next_ = frame.start;
    return set_locals(frame.arguments, frame.locals);
  }
  next_ = frame.back;
  set_locals(frame.saved, frame.locals);
  if (saved_.back() && restores_.back()) restore();
  saved_.pop_back();
  restores_.pop_back();
  frames_.pop_back();
  locals_.pop_back();
}

void WordReader::set_locals(const std::unordered_map<int, double>& values, int count) {
  for (int n = 1; n <= count; ++n) numbers_.erase(n);
  for (const auto& [n, v] : values) numbers_[n] = v;
}

void WordReader::enter_sub(Frame frame) {
  frames_.push_back(std::move(frame));
  locals_.emplace_back();
  saved_.emplace_back();
  restores_.push_back(false);
}

/// M70 to M73: each level of call has its own memory.
void WordReader::keep_modes(int code) {
  if (code == 70 || code == 73) {
    saved_.back() = Modes{unit_, rpm_, feed_, incremental_, centre_absolute_, to_r_level_, plane_, spindle_, offset_};
    restores_.back() = code == 73;
    if (code == 73 && frames_.empty()) reject(1, "M73 outside of a subprogram");
    return;
  }
  if (!saved_.back()) reject(1, "M" + std::to_string(code) + " without modes that M70 has kept");
  if (code == 72) restore();
  if (code == 71) saved_.back().reset();
}

void WordReader::restore() {
  const Modes& kept = *saved_.back();
  unit_ = kept.unit;
  feed_ = kept.feed;
  incremental_ = kept.incremental;
  centre_absolute_ = kept.centre_absolute;
  to_r_level_ = kept.to_r_level;
  plane_ = kept.plane;
  if (offset_ != kept.offset) {
    offset_ = kept.offset;
    renew_offset();
  }
  if (spindle_ != kept.spindle || (spindle_ != 5 && rpm_ != kept.rpm)) {
    path_.say(ProgramStep::kSpindle, kept.spindle, kept.spindle == 5 ? 0 : kept.rpm);
  }
  spindle_ = kept.spindle;
  rpm_ = kept.rpm;
}

/// Out of the loop of this name, or to its end for the next round.
void WordReader::leave_loop(const std::string& name, int where, bool again) {
  while (!loops_.empty() && loops_.back().label != name &&
         loops_.size() > (frames_.empty() ? 0 : frames_.back().loops)) {
    loops_.pop_back();  // loops inside
  }
  const bool counted = !loops_.empty() && loops_.back().label == name;
  if (!counted && whiles_.find(name) == whiles_.end()) reject(where, "break or continue outside of its loop");
  const std::size_t end = find(next_, name, {"ENDWHILE", "ENDREPEAT", "WHILE"});
  next_ = again ? end : end + 1;
  if (!again && counted) loops_.pop_back();
}

void WordReader::flow() {
  ++p_;  // O
  const int where = column();
  const std::string name = label();
  if (p_ == end_ && name.find_first_not_of("0123456789") == std::string::npos) return;  // begins what M98 calls
  if (take("SUB")) {
    next_ = find(next_, name, {"ENDSUB"}) + 1;
  } else if (take("ENDSUB") || take("RETURN")) {
    if (frames_.empty()) reject(where, "return outside of a subprogram");
    if (p_ != end_) globals_["_VALUE"] = bracket(0);
    leave_sub();
  } else if (take("CALL")) {
    if (frames_.size() >= kDeepestCall) reject(where, "subprograms nested too deeply");
    std::vector<double> arguments;
    while (p_ != end_ && *p_ == '[' && arguments.size() < kLocals) arguments.push_back(bracket(0));
    auto sub = subs_.find(name);
    if (sub == subs_.end()) sub = subs_.emplace(name, find(0, name, {"SUB"})).first;
    Frame frame{next_, {}, loops_.size(), kLocals};
    for (int n = 1; n <= kLocals; ++n) {
      if (const auto old = numbers_.find(n); old != numbers_.end()) frame.saved[n] = old->second;
      numbers_[n] = static_cast<std::size_t>(n) <= arguments.size() ? arguments[static_cast<std::size_t>(n) - 1] : 0;
    }
    enter_sub(std::move(frame));
    next_ = sub->second + 1;
  } else if (take("IF")) {
    bool go = bracket(0) != 0;
    std::size_t line = next_;
    while (!go) {
      std::string_view word;
      line = find(line, name, {"ELSEIF", "ELSE", "ENDIF"}, &word) + 1;
      next_ = line;
      go = word != "ELSEIF" || bracket(0) != 0;
      if (word != "ELSEIF") p_ = end_;
    }
    p_ = end_;
  } else if (take("ELSEIF") || take("ELSE")) {
    next_ = find(next_, name, {"ENDIF"}) + 1;
    p_ = end_;
  } else if (take("ENDIF")) {
  } else if (take("DO")) {
    loops_.push_back({name, next_, 0, false});
  } else if (take("WHILE")) {
    const bool again = bracket(0) != 0;
    if (!loops_.empty() && loops_.back().label == name && !loops_.back().repeats) {  // the end of a do
      if (again)
        next_ = loops_.back().line;
      else
        loops_.pop_back();
    } else if (!again) {
      next_ = find(next_, name, {"ENDWHILE"}) + 1;
    } else {
      whiles_[name] = at_;
    }
  } else if (take("ENDWHILE")) {
    const auto start = whiles_.find(name);
    if (start == whiles_.end()) reject(where, "endwhile without while");
    next_ = start->second;
  } else if (take("REPEAT")) {
    const double count = bracket(0);
    if (count < 1)
      next_ = find(next_, name, {"ENDREPEAT"}) + 1;
    else
      loops_.push_back({name, next_, std::floor(count), true});
  } else if (take("ENDREPEAT")) {
    if (loops_.empty() || loops_.back().label != name) reject(where, "endrepeat without repeat");
    if ((loops_.back().left -= 1) >= 1)
      next_ = loops_.back().line;
    else
      loops_.pop_back();
  } else if (take("BREAK") || take("CONTINUE")) {
    leave_loop(name, where, p_[-1] == 'E');
  } else {
    reject(column(), "unknown word after the O number");
  }
  if (p_ != end_) reject(column(), "nothing may follow an O word's arguments");
}

}  // namespace lightmill::detail
