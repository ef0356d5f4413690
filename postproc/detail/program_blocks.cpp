#include "postproc/detail/program_blocks.h"

#include <charconv>
#include <cmath>
#include <vector>

namespace lightmill::detail {
namespace {

constexpr std::size_t kLongestLine = 80;
constexpr std::string_view kRealTimeCharacters = "!?~%$";
constexpr std::string_view kLastIsoNumber = "N99999999 ";

// The next token of `rest`, which moves behind it; empty at the end.
std::string_view next_token(std::string_view& rest) {
  while (!rest.empty() && rest.front() == ' ') rest.remove_prefix(1);
  const std::size_t end = std::min(rest.find(' '), rest.size());
  const std::string_view token = rest.substr(0, end);
  rest.remove_prefix(end);
  return token;
}

// A whole token that is a number, with a sign if need be.
double value_of(std::string_view text) {
  if (!text.empty() && text.front() == '+') {
    text.remove_prefix(1);
    if (!text.empty() && text.front() == '-') return kNotSaid;
  }
  const std::string_view digits = text.substr(!text.empty() && text.front() == '-' ? 1 : 0);
  if (digits.empty() || digits.front() < '0' || digits.front() > '9') return kNotSaid;
  double value = 0;
  const auto [stop, error] = std::from_chars(text.data(), text.data() + text.size(), value, std::chars_format::fixed);
  return error == std::errc() && stop == text.data() + text.size() ? value : kNotSaid;
}

}  // namespace

void BlockReader::line(std::string_view text) {
  ++line_;
  if (dialect_.line_end == "\r\n") {
    if (!text.ends_with('\r')) {
      complain("the line does not end with carriage return and line feed");
    } else {
      text.remove_suffix(1);
    }
  }
  if (closed_) return static_cast<void>(complain("a line after the program's end"));
  if (dialect_.percent && text == "%") {
    ++percents_;
    if (line_ != 1) closed_ = true;
    return;
  }
  if (dialect_.program_number && line_ == 2) {
    if (text.size() != 5 || text.front() != 'O' || text.find_first_not_of("0123456789", 1) != std::string_view::npos) {
      complain("the program's number is missing: O and four digits");
    }
    return;
  }
  if (text.size() > kLongestLine) complain("longer than 80 characters");
  for (const char c : text) {
    if (c < ' ' || c > '~') return static_cast<void>(complain("a character that is not printable ASCII"));
    if (dialect_.language == Language::kRs274 && kRealTimeCharacters.find(c) != std::string_view::npos) {
      return static_cast<void>(complain(std::string("'") + c + "' would act as a real-time command"));
    }
  }
  if (text.empty()) return static_cast<void>(complain("an empty line"));
  switch (dialect_.language) {
    case Language::kRs274:
      if (text.front() == '(') {
        if (text.find(')') != text.size() - 1 || text.rfind('(') != 0)
          complain("a comment that does not end with its line");
        return;
      }
      return words(text);
    case Language::kSiemens:
      if (text.front() == ';') {
        if (line_ == 1) {
          constexpr std::string_view kNameLetters = "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_";
          opened_ = text.starts_with("; %_N_") && text.ends_with("_MPF") &&
                    text.find_first_not_of(kNameLetters, 3) == std::string_view::npos;
          if (!opened_) complain("the program does not begin with its name");
        }
        return;
      }
      return words(text);
    case Language::kHeidenhainIso: {
      std::string_view rest = text;
      if (line_ == 1) {
        if (!rest.starts_with('%') || !rest.ends_with(" G71 *")) {
          return static_cast<void>(complain("the program does not begin with %, its name and G71"));
        }
        name_ = rest;
        opened_ = true;
        Block block;
        block.order(Order::kMetric);
        return events_.run(block);
      }
      if (rest.starts_with(kLastIsoNumber)) {
        if (rest.substr(kLastIsoNumber.size()) != name_) complain("the program's end names another program");
        closed_ = true;
        return;
      }
      const std::string_view label = next_token(rest);
      if (!label.starts_with('N') || value_of(label.substr(1)) != ++next_number_) {
        return static_cast<void>(
            complain("block number N" + std::to_string(static_cast<long>(next_number_)) + " expected"));
      }
      if (rest.starts_with(" ;")) return;
      if (!rest.ends_with(" *")) return static_cast<void>(complain("a block that does not end with *"));
      return words(rest.substr(0, rest.size() - 2));
    }
    case Language::kConversational:
      return conversational(text);
  }
}

void BlockReader::finish() {
  if (dialect_.percent && (percents_ != 2 || !closed_)) complain("the program must stand between two lines of %");
  if (dialect_.language == Language::kHeidenhainIso || dialect_.language == Language::kConversational) {
    if (!opened_ || !closed_) complain("the program's frame is not closed");
  }
  if (!cycle_.empty() || continues_) complain("a cycle without its values");
}

int BlockReader::axis_of(char letter) const {
  if (letter >= 'X' && letter <= 'Z') return letter - 'X';
  if (!machine_.has_rotary()) return -1;
  if (letter == machine_.outer.letter) return 3;
  return letter == machine_.inner.letter ? 4 : -1;
}

// Words of a letter and a number, the same for RS274, Siemens and DIN/ISO; then what they mean together.
void BlockReader::words(std::string_view text) {
  Block block;
  std::string_view rest = text;
  double p = kNotSaid, h = kNotSaid, q = kNotSaid, d = kNotSaid;
  int dwell = 0, length = 0, smooth = 0, ai = 0;
  std::uint32_t seen = 0;
  const bool siemens = dialect_.language == Language::kSiemens;
  const bool iso = dialect_.language == Language::kHeidenhainIso;
  const auto no_words = [&](std::string_view token) {
    complain("not words of a letter and a number: '" + std::string(token) + "'");
  };
  for (std::string_view token = next_token(rest); !token.empty(); token = next_token(rest)) {
    if (siemens && token.size() > 3) {
      if (token == "SUPA") {
        block.order(Order::kMachine);
        continue;
      }
      if (token == "TRAORI" || token == "TRAFOOF") {
        block.order(token == "TRAORI" ? Order::kTcpOn : Order::kTcpOff);
        continue;
      }
      if (token == "ORIWKS" && rest == " ORIAXES") {
        rest = {};
        block.order(Order::kTcpFrame);
        continue;
      }
      if (token.starts_with("CYCLE832(") && token.ends_with(')')) {
        const std::string_view values = token.substr(9, token.size() - 10);
        const std::size_t one = values.find(','), two = values.rfind(',');
        const std::string_view kind = one == two ? std::string_view() : values.substr(one + 1, two - one - 1);
        const double within = value_of(values.substr(0, one)), last = value_of(values.substr(two + 1));
        if (within == 0 && kind == "_OFF" && last == 1) {
          block.order(Order::kSmoothOff);
        } else if (within > 0 && ((kind == "_FINISH" && last == 1) || (kind == "_ORI_FINISH" && last > 0))) {
          block.order(Order::kSmoothOn);
          block.smoothing = within;
          if (kind == "_ORI_FINISH") block.smoothing_angle = last;
        } else {
          complain("CYCLE832 is not what was asked for");
        }
        continue;
      }
      if (const int axis = axis_of(token[0]);
          axis >= 3 && token.substr(1).starts_with("=DC(") && token.ends_with(')')) {
        const double angle = value_of(token.substr(5, token.size() - 6));
        if (!(angle >= 0 && angle < 360)) complain("an angle of a modulo axis outside 0 to 360");
        if (block.said(axis)) complain(std::string("two words ") + token[0]);
        block.axis[static_cast<std::size_t>(axis)] = angle;
        block.short_way = true;
        continue;
      }
    }
    if (iso && token == "P01") {
      if (next_token(rest) != "0") complain("G62 P01 is not 0, finishing");
      continue;
    }
    if (iso && token == "P02") {
      if (!std::isnan(block.smoothing_angle)) complain("two words P02");
      block.smoothing_angle = value_of(next_token(rest));
      if (!(block.smoothing_angle >= 0)) complain("G62 P02 without an angle");
      continue;
    }
    if (iso && token.starts_with("Q339=")) {
      q = value_of(token.substr(5));
      continue;
    }
    if (iso && token.starts_with("DL")) {
      block.delta = value_of(token.substr(2));
      if (std::isnan(block.delta)) return no_words(token);
      continue;
    }
    const char letter = token.front();
    const double value = value_of(token.substr(1));
    if (letter < 'A' || letter > 'Z' || std::isnan(value)) return no_words(text);
    if (letter == 'G') {
      const double tenths = value * 10;
      switch (tenths < 0 ? -1 : static_cast<int>(std::lround(tenths))) {
        case 0:
          block.order(Order::kRapid);
          break;
        case 10:
          block.order(Order::kFeed);
          break;
        case 20:
        case 30:
          block.order(!dialect_.arcs ? Order::kCount : value == 2 ? Order::kClockwise : Order::kCounterClockwise);
          break;
        case 180:
        case 190:
          block.order(!dialect_.arcs ? Order::kCount : value == 18 ? Order::kPlaneZx : Order::kPlaneYz);
          break;
        case 911:
          block.order(dialect_.arcs && !dialect_.arc_centre_is_relative ? Order::kRelativeCentre : Order::kCount);
          break;
        case 40:
          dwell = 1;
          break;
        case 170:
          block.order(Order::kPlane);
          break;
        case 210:
          block.order(iso || siemens ? Order::kCount : Order::kMetric);
          break;
        case 710:
          block.order(siemens ? Order::kMetric : Order::kCount);
          break;
        case 400:
          block.order(Order::kNoRadius);
          break;
        case 800:
          block.order(siemens || iso ? Order::kCount : Order::kNoCycle);
          break;
        case 900:
          block.order(Order::kAbsolute);
          break;
        case 940:
          block.order(iso ? Order::kCount : Order::kPerMinute);
          break;
        case 930:
          block.order(iso ? Order::kCount : Order::kInverse);
          break;
        case 490:
          block.order(siemens || iso ? Order::kCount : Order::kLengthOff);
          break;
        case 530:
          block.order(siemens || iso ? Order::kCount : Order::kMachine);
          break;
        case 430:
          length = 430;
          break;
        case 431:
          length = 431;
          break;
        case 434:
          length = 434;
          break;
        case 640:
          smooth = 640;
          break;
        case 620:
          smooth = 620;
          break;
        case 51:
          ai = 1;
          break;
        case 300:
        case 310:
          block.order(iso ? Order::kBlank : Order::kCount);
          break;
        case 2470:
          smooth = 2470;
          break;
        case 540:
        case 550:
        case 560:
        case 570:
        case 580:
        case 590:
          block.order(iso ? Order::kCount : Order::kOffset);
          block.offset = static_cast<int>(value);
          break;
        default:
          complain("G" + std::string(token.substr(1)) + " has no place in this program");
      }
      continue;
    }
    if (letter == 'M') {
      if (value == 428 && dialect_.name == "linuxcnc") {
        block.order(Order::kTcpOn);
      } else if (value == 429 && dialect_.name == "linuxcnc") {
        block.order(Order::kTcpOff);
      } else if (iso && value == 91) {
        block.order(Order::kMachine);
      } else if (iso && (value == 128 || value == 129)) {
        block.order(value == 128 ? Order::kTcpOn : Order::kTcpOff);
      } else if (iso && (value == 126 || value == 127)) {
        block.order(value == 126 ? Order::kShortWay : Order::kLongWay);
      } else if (value >= 0 && value <= 30 && value == std::floor(value)) {
        block.m_codes |= 1ULL << static_cast<int>(value);
      } else {
        complain("M" + std::string(token.substr(1)) + " has no place in this program");
      }
      continue;
    }
    const std::uint32_t bit = 1U << (letter - 'A');
    if ((seen & bit) != 0) complain(std::string("two words ") + letter);
    seen |= bit;
    const int axis = axis_of(letter);
    if (dialect_.decimal_point && (axis >= 0 || letter == 'F' || (letter >= 'I' && letter <= 'K')) && token.find('.') == std::string_view::npos) {
      complain(std::string(1, letter) + " without a decimal point");
    }
    if (axis >= 0 && std::abs(value) >= std::pow(10.0, dialect_.whole_digits))
      complain("a number too long for the control");
    if (dialect_.plus_sign && axis >= 0 && token[1] != '+' && token[1] != '-')
      complain(std::string(1, letter) + " without a sign");
    if (axis >= 0) {
      if (value == 0 && std::signbit(value)) complain("a minus before zero");
      block.axis[static_cast<std::size_t>(axis)] = value;
      continue;
    }
    switch (letter) {
      case 'F':
        block.f = value;
        break;
      case 'S':
        block.s = value;
        break;
      case 'T':
        block.t = value;
        break;
      case 'P':
        p = value;
        break;
      case 'H':
        h = value;
        break;
      case 'Q':
        q = value;
        break;
      case 'D':
        d = value;
        break;
      case 'I':
      case 'J':
      case 'K':
        block.centre[static_cast<std::size_t>(letter - 'I')] = value;
        break;
      case 'N':
        if (!(value > next_number_)) complain("block numbers do not grow");
        next_number_ = value;
        break;
      default:
        complain(std::string("a word ") + letter + " that this machine does not know");
    }
  }
  // What the words mean together.
  if (block.has(Order::kCount)) return static_cast<void>(complain("a G code that this control does not know"));
  if (dwell != 0) {
    double& time = siemens || iso ? block.f : p;
    if (!(time > 0)) complain("a dwell without its time");
    block.order(Order::kDwell);
    block.time = time * (dialect_.dwell_in_ms ? 1e-3 : 1);
    time = kNotSaid;
  }
  if (length == 431) {
    if (dialect_.length_in_table) complain("G43.1 is unknown to this controller");
    if (block.rotary() || block.said(0) || block.said(1)) complain("G43.1 with other axis words");
    block.order(Order::kLengthSaid);
    block.length = block.axis[2];
    block.axis[2] = kNotSaid;
  } else if (length != 0) {
    if (!dialect_.length_in_table) complain("G43 needs a tool table, which this controller has not");
    if (length == 434 && !dialect_.length_with_descent) complain("G43.4 is unknown to this controller");
    if (!(h >= 1)) complain("G43 without H");
    block.order(Order::kLengthOn);
    block.length_of = std::isnan(h) ? 0 : static_cast<int>(h);
    if (length == 434) block.order(Order::kTcpOn);
    h = kNotSaid;
    if ((block.linear() || block.rotary()) != dialect_.length_with_descent) {
      complain(dialect_.length_with_descent ? "G43 without the way down" : "G43 with axis words");
    }
  }
  if (dialect_.length_with_descent && block.has(Order::kLengthOff)) block.order(Order::kTcpOff);
  if (smooth == 640) {
    if (dialect_.name != "linuxcnc" || !(p >= 0)) complain("G64 P is not what was asked for");
    block.order(Order::kSmoothOn);
    block.smoothing = p;
    p = kNotSaid;
  }
  if (smooth == 620) {
    if (!iso || block.t < 0) complain("G62 is not what was asked for");
    block.order(std::isnan(block.t) ? Order::kSmoothOff : Order::kSmoothOn);
    block.smoothing = block.t;
    block.t = kNotSaid;
  }
  if (smooth == 2470) {
    if (!iso || !(q >= 1)) complain("G247 without its datum");
    block.order(Order::kOffset);
    block.offset = static_cast<int>(q) + 53;
    q = kNotSaid;
  }
  if (ai != 0) {
    if (dialect_.name != "fanuc" || (q != 0 && q != 1)) complain("G5.1 Q is not 0 or 1");
    block.order(q == 1 ? Order::kSmoothOn : Order::kSmoothOff);
    block.smoothing = 0;
    q = kNotSaid;
  }
  if (siemens && !std::isnan(d)) {
    block.order(d == 0 ? Order::kNoLength : Order::kLengthOn);
    if (d != 0 && d != 1) complain("D is not 0 or 1");
    d = kNotSaid;
  }
  if (iso && block.has(Order::kBlank)) {
    if (!block.said(0) || !block.said(1) || !block.said(2)) complain("a blank's corner without X, Y and Z");
  }
  if (iso && !std::isnan(block.t)) {  // calls the tool, its length, and its speed
    if (!block.has(Order::kPlane)) complain("a tool call without its axis");
    block.order(Order::kLengthOn);
    block.m_codes |= 1ULL << 6;
  }
  if (!std::isnan(p)) complain("P without a dwell");
  if (!std::isnan(h) || !std::isnan(q) || !std::isnan(d)) complain("a word H, Q or D without its use");
  events_.run(block);
}

void BlockReader::conversational(std::string_view text) {
  std::string_view rest = text;
  if (continues_) {
    continues_ = false;
    const std::string_view token = next_token(rest);
    Block block;
    block.order(Order::kOffset);
    const double datum = token.starts_with("Q339=") ? value_of(token.substr(5)) : kNotSaid;
    if (!(datum >= 1) || !next_token(rest).empty()) return static_cast<void>(complain("cycle 247 needs Q339"));
    block.offset = static_cast<int>(datum) + 53;
    return events_.run(block);
  }
  const std::string_view label = next_token(rest);
  if (value_of(label) != next_number_) {
    return static_cast<void>(complain("block number " + std::to_string(static_cast<long>(next_number_)) + " expected"));
  }
  ++next_number_;
  if (rest.starts_with(" ;")) return;
  conversational_block(rest.substr(std::min<std::size_t>(1, rest.size())));
}

void BlockReader::conversational_block(std::string_view text) {
  std::string_view rest = text;
  const std::string_view first = next_token(rest);
  const auto unknown = [&] { complain("'" + std::string(text) + "' has no place in this program"); };
  if (!cycle_.empty() && first != "CYCL") {
    complain("a cycle without its values");
    cycle_ = {};
  }
  Block block;
  if (first == "BEGIN" || first == "END") {
    if (!rest.starts_with(" PGM ") || !rest.ends_with(" MM")) return unknown();
    if (first == "BEGIN") {
      if (opened_) return unknown();
      opened_ = true;
      name_ = rest;
      block.order(Order::kMetric);
      return events_.run(block);
    }
    if (rest != name_) complain("END PGM names another program");
    closed_ = true;
    return;
  }
  if (!opened_) return static_cast<void>(complain("BEGIN PGM is missing"));
  if (first == "BLK") {
    const bool low = rest.starts_with(" FORM 0.1 Z X");
    if (!low && !rest.starts_with(" FORM 0.2 X")) return unknown();
    rest.remove_prefix(low ? 12 : 10);
    block.order(Order::kBlank);
    for (std::size_t i = 0; i < 3; ++i) {
      const std::string_view token = next_token(rest);
      block.axis[i] = token.size() > 1 && token.front() == "XYZ"[i] ? value_of(token.substr(1)) : kNotSaid;
      if (!block.said(static_cast<int>(i))) return unknown();
    }
    return events_.run(block);
  }
  if (first == "CYCL") {
    if (!rest.starts_with(" DEF ")) return unknown();
    rest.remove_prefix(5);
    bool runs = false;
    cycle(rest, block, runs);
    if (runs) events_.run(block);
    return;
  }
  if (first == "TOOL") {
    if (next_token(rest) != "CALL") return unknown();
    block.t = value_of(next_token(rest));
    if (next_token(rest) != "Z") complain("TOOL CALL without its axis");
    block.order(Order::kPlane);
    block.order(Order::kLengthOn);
    block.m_codes |= 1ULL << 6;
    for (std::string_view token = next_token(rest); !token.empty(); token = next_token(rest)) {
      if (token.starts_with("DL")) {
        block.delta = value_of(token.substr(2));
      } else if (token.front() == 'S') {
        block.s = value_of(token.substr(1));
      } else {
        return unknown();
      }
    }
    if (std::isnan(block.t) || std::isnan(block.s) || std::isnan(block.delta)) return unknown();
    return events_.run(block);
  }
  bool fmax = false;
  std::string_view token = first;
  const bool moves = first == "L";
  if (moves) token = next_token(rest);
  for (; !token.empty(); token = next_token(rest)) {
    const double value = value_of(token.substr(1));
    const int axis = moves ? axis_of(token.front()) : -1;
    if (axis >= 0 && !std::isnan(value)) {
      if (token[1] != '+' && token[1] != '-') complain(std::string(1, token.front()) + " without a sign");
      if (block.said(axis)) complain(std::string("two words ") + token.front());
      if (value == 0 && std::signbit(value)) complain("a minus before zero");
      if (std::abs(value) >= std::pow(10.0, dialect_.whole_digits)) complain("a number too long for the control");
      block.axis[static_cast<std::size_t>(axis)] = value;
    } else if (moves && token == "R0") {
      block.order(Order::kNoRadius);
    } else if (moves && token == "FMAX") {
      fmax = true;
    } else if (moves && token.starts_with("FT")) {
      block.order(Order::kTimed);
      block.time = value_of(token.substr(2));
      if (!(block.time > 0)) return unknown();
    } else if (moves && token.front() == 'F' && !std::isnan(value)) {
      block.f = value;
    } else if (token.front() == 'M' && !std::isnan(value)) {
      if (value == 91) {
        block.order(Order::kMachine);
      } else if (value == 126 || value == 127) {
        block.order(value == 126 ? Order::kShortWay : Order::kLongWay);
      } else if (value == 128 || value == 129) {
        block.order(value == 128 ? Order::kTcpOn : Order::kTcpOff);
      } else if (value >= 0 && value <= 30 && value == std::floor(value)) {
        block.m_codes |= 1ULL << static_cast<int>(value);
      } else {
        return unknown();
      }
    } else {
      complain("not words of a letter and a number: '" + std::string(token) + "'");
      return;
    }
  }
  if (moves) block.order(fmax ? Order::kRapid : Order::kFeed);
  events_.run(block);
}

void BlockReader::cycle(std::string_view rest, Block& block, bool& runs) {
  const auto unknown = [&] { complain("'CYCL DEF " + std::string(rest) + "' has no place in this program"); };
  if (rest == "247 DATUM SETTING ~") {
    continues_ = true;
    return;
  }
  if (rest == "9.0 DWELL TIME" || rest == "32.0 TOLERANCE") {
    if (!cycle_.empty()) complain("a cycle without its values");
    cycle_ = rest.substr(0, rest.find('.'));
    return;
  }
  const bool tolerance_goes_on = rest.starts_with("32.2 HSC-MODE:0 TA");
  if (!tolerance_goes_on && (cycle_.empty() || !rest.starts_with(cycle_))) return unknown();
  runs = true;
  if (rest.starts_with("9.1 DWELL ")) {
    block.order(Order::kDwell);
    block.time = value_of(rest.substr(10));
    if (!(block.time > 0)) unknown();
  } else if (rest == "32.1") {
    block.order(Order::kSmoothOff);
  } else if (rest.starts_with("32.1 T")) {
    held_ = {};
    held_.smoothing = value_of(rest.substr(6));
    if (!(held_.smoothing > 0)) unknown();
    runs = false;
    return;  // 32.2 follows
  } else if (tolerance_goes_on && cycle_ == "32" && held_.smoothing > 0) {
    block.order(Order::kSmoothOn);
    block.smoothing = held_.smoothing;
    held_ = {};
    block.smoothing_angle = value_of(rest.substr(18));
    if (!(block.smoothing_angle >= 0)) unknown();
  } else {
    runs = false;
    unknown();
  }
  cycle_ = {};
}

}  // namespace lightmill::detail
