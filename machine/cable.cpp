#include "machine/cable.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <random>

#include "design/core/errors.h"

namespace lightmill {

namespace {

using Kind = LineFault::Kind;
constexpr std::string_view kOk = "ok\r\n";
constexpr char kXon = 0x11;
constexpr double kBitsPerByte = 10;
constexpr double kNanosecondsPerSecond = 1e9;

}  // namespace

std::optional<long> fault_place(std::string_view text, unsigned seed) {
  const std::size_t at = text.find('@');
  if (at == std::string_view::npos) {
    constexpr unsigned long kPlaces = 1000;
    return static_cast<long>(1 + std::mt19937(seed)() % kPlaces);
  }
  long place = 0;
  const char* const end = text.data() + text.size();
  const auto [stopped, error] = std::from_chars(text.data() + at + 1, end, place);
  if (error != std::errc() || stopped != end || place < 1) return std::nullopt;
  return place;
}

LineFault line_fault(std::string_view text, unsigned seed) {
  struct Named {
    std::string_view name;
    LineFault fault;
  };
  static const Named kNamed[] = {{"drop", {.kind = Kind::kDropByte}},
                                 {"flip", {.kind = Kind::kFlipByte}},
                                 {"double", {.kind = Kind::kDoubleByte}},
                                 {"drop-ok", {.kind = Kind::kDropOk, .to_machine = false}},
                                 {"double-ok", {.kind = Kind::kDoubleOk, .to_machine = false}},
                                 {"late-ok", {.kind = Kind::kLateOk, .to_machine = false, .seconds = 2}},
                                 {"drop-xon", {.kind = Kind::kDropXon, .to_machine = false}},
                                 {"slow", {.kind = Kind::kSlow, .seconds = 0.01}},
                                 {"hang-up", {.kind = Kind::kHangUp}}};
  const auto place = fault_place(text, seed);
  for (const Named& named : kNamed) {
    if (!place || text.substr(0, text.find('@')) != named.name) continue;
    LineFault fault = named.fault;
    fault.at = *place;
    return fault;
  }
  std::string known;
  for (const Named& named : kNamed) known += (known.empty() ? "" : ", ") + std::string(named.name);
  throw InputError("line fault '" + std::string(text) + "' is none of " + known +
                   ", with a place from 1 as in flip@120");
}

Cable::Cable(const LineOptions& line, bool to_machine)
    : byte_ns_(line.baud > 0 ? kBitsPerByte / line.baud * kNanosecondsPerSecond : 0),
      even_parity_(line.even_parity) {
  for (const LineFault& fault : line.faults) {
    if (fault.to_machine == to_machine) faults_.push_back(fault);
  }
}

const LineFault* Cable::planted(Kind kind, long at) const {
  for (const LineFault& fault : faults_) {
    const bool lasts = kind == Kind::kDropXon || kind == Kind::kSlow;
    if (fault.kind == kind && (fault.at == at || (lasts && at > fault.at))) return &fault;
  }
  return nullptr;
}

void Cable::put(std::string_view bytes, ClockTime now) {
  for (std::size_t i = 0; i < bytes.size(); ++i) {
    if (hung_up_) return;
    if (faults_.empty()) {
      ++bytes_;
      send(bytes[i], now);
      continue;
    }
    // A machine says its acknowledgements whole.
    const bool ok = line_start_ && bytes.substr(i).starts_with(kOk);
    if (ok) {
      ++oks_;
      if (const LineFault* late = planted(Kind::kLateOk, oks_)) {
        free_ns_ = std::max(free_ns_, static_cast<double>(now.count())) + late->seconds * kNanosecondsPerSecond;
      }
      if (planted(Kind::kDoubleOk, oks_) != nullptr) {
        for (const char byte : kOk) send(byte, now);
      }
      if (planted(Kind::kDropOk, oks_) != nullptr) {
        bytes_ += static_cast<long>(kOk.size());
        i += kOk.size() - 1;
        continue;
      }
    }
    char byte = bytes[i];
    line_start_ = byte == '\n';
    ++bytes_;
    if (planted(Kind::kHangUp, bytes_) != nullptr) {
      hung_up_ = true;
      return;
    }
    if (planted(Kind::kDropByte, bytes_) != nullptr) continue;
    if (byte == kXon && planted(Kind::kDropXon, ++xons_) != nullptr) continue;
    if (const LineFault* slow = planted(Kind::kSlow, bytes_)) delay_ns_ = slow->seconds * kNanosecondsPerSecond;
    if (const LineFault* flip = planted(Kind::kFlipByte, bytes_)) {
      byte = even_parity_ ? '\0' : static_cast<char>(byte ^ (1 << flip->bit));
    }
    if (planted(Kind::kDoubleByte, bytes_) != nullptr) send(byte, now);
    send(byte, now);
  }
}

void Cable::send(char byte, ClockTime now) {
  const double takes = byte_ns_ + delay_ns_;
  free_ns_ = std::max(free_ns_, static_cast<double>(now.count())) + takes;
  busy_seconds_ += takes / kNanosecondsPerSecond;
  under_way_.push_back({byte, ClockTime(static_cast<ClockTime::rep>(std::ceil(free_ns_)))});
}

std::string Cable::take(ClockTime now) {
  std::string arrived;
  while (!under_way_.empty() && under_way_.front().arrival <= now) {
    arrived += under_way_.front().value;
    under_way_.pop_front();
  }
  return arrived;
}

}  // namespace lightmill
