// The codes that a control of words knows, and what they ask for.
#include "machine/detail/word_reader.h"

namespace lightmill::detail {

std::string WordReader::code_name(int tenths) {
  return std::to_string(tenths / 10) + (tenths % 10 != 0 ? "." + std::to_string(tenths % 10) : "");
}

/// What LinuxCNC knows and this machine cannot do, and all else.
const char* WordReader::why_refused(char letter, int tenths) const {
  if (letter == 'G' && !fanuc_) {
    if (tenths == 330 || tenths == 331 || tenths == 760)
      return " waits for a spindle encoder, which this machine has not";
    if (tenths == 70 || (tenths >= 700 && tenths < 730) || tenths == 960) return " is for lathes";
  }
  return " is not known to this control";
}

int WordReader::g_group(int tenths) const {
  switch (tenths) {
    case 0:
    case 10:
    case 20:
    case 30:
    case 730:
    case 740:
    case 800:
    case 810:
    case 820:
    case 830:
    case 840:
    case 850:
    case 860:
    case 890:
      return 1;
    case 50:
    case 52:
    case 53:
    case 382:
    case 383:
    case 384:
    case 385:
    case 870:
    case 880:
      return fanuc_ ? -1 : 1;
    case 170:
    case 180:
    case 190:
      return 2;
    case 900:
    case 910:
      return 3;
    case 901:
    case 911:
      return fanuc_ ? -1 : 4;
    case 930:
    case 940:
    case 950:
      return 5;
    case 200:
    case 210:
      return 6;
    case 400:
      return 7;
    case 410:
    case 420:
      return 7;
    case 411:
    case 421:
      return fanuc_ ? -1 : 7;
    case 430:
    case 490:
      return 8;
    case 431:
      return fanuc_ ? -1 : 8;
    case 434:
    case 435:
      return fanuc_ ? 8 : -1;
    case 682:
    case 690:
      return fanuc_ ? 9 : -1;
    case 660:
    case 670:
      return fanuc_ ? 11 : -1;
    case 531:
    case 650:
      return fanuc_ ? 0 : -1;
    case 980:
    case 990:
      return 10;
    case 540:
    case 550:
    case 560:
    case 570:
    case 580:
    case 590:
      return 12;
    case 541:
      return fanuc_ ? 12 : -1;
    case 591:
    case 592:
    case 593:
      return fanuc_ ? -1 : 12;
    case 610:
    case 640:
      return 13;
    case 611:
      return fanuc_ ? -1 : 13;
    case 40:
    case 100:
    case 280:
    case 520:
    case 530:
    case 920:
    case 921:
      return 0;
    case 281:
    case 300:
    case 301:
    case 922:
    case 923:
      return fanuc_ ? -1 : 0;
    case 51:
      return fanuc_ ? 0 : 1;
    case 432:
      return fanuc_ ? -1 : 8;
    case 80:
      return fanuc_ ? -1 : 15;  // the diameters of lathes are not for this machine: G7 is refused
    case 970:
      return fanuc_ ? -1 : 14;
    default:
      return -1;
  }
}

int WordReader::m_group(int tenths) const {
  if (tenths % 10 != 0) return -1;
  switch (tenths / 10) {
    case 0:
    case 1:
    case 2:
    case 30:
      return 4;
    case 60:
      return fanuc_ ? -1 : 4;
    case 3:
    case 4:
    case 5:
      return 7;
    case 6:
      return 6;
    case 7:
    case 8:
    case 9:
      return 8;
    case 48:
    case 49:
    case 50:
    case 51:
    case 52:
    case 53:
      return fanuc_ ? -1 : 9;
    case 62:
    case 63:
    case 64:
    case 65:
    case 66:
    case 67:
    case 68:
      return fanuc_ ? -1 : 5;
    case 70:
    case 71:
    case 72:
    case 73:
      return fanuc_ ? -1 : 5;
    case 428:
    case 429:
      return fanuc_ ? -1 : 10;  // the trunnion configurations' remaps
    case 98:
    case 99:
      return 4;
    default:
      return -1;
  }
}

void WordReader::take_g(const Code& g, Request& request) {
  const int code = g.tenths / 10;
  switch (g.group) {
    case 0:
      (g.tenths == 650 ? request.macro : request.shot) = g.tenths;
      break;
    case 1:
      request.motion = g.tenths;
      break;
    case 2:
      plane_ = code - 17;
      break;
    case 3:
      incremental_ = code == 91;
      break;
    case 4:
      centre_absolute_ = g.tenths == 901;
      break;
    case 5:
      request.feed_mode = code;
      break;
    case 6:
      unit_ = code == 20 ? kMmPerInch : 1;
      break;
    case 7:
      request.compensation = g.tenths;
      break;
    case 8:
      request.length = g.tenths;
      break;
    case 9:
      request.plane = g.tenths;
      break;
    case 10:
      to_r_level_ = code == 99;
      break;
    case 11:
      request.macro = g.tenths;
      break;
    case 12:
      request.offset = g.tenths == 541 ? more_offset() : g.tenths >= 591 ? g.tenths - 591 + 6 : code - 54;
      break;
    case 13:
      set_corners(g.tenths);
      break;
    default:
      break;
  }
}

void WordReader::set_corners(int tenths) {
  core_.exact_stop = tenths == 611 || (fanuc_ && tenths == 610);
  core_.corner_tolerance_mm = fanuc_ ? -1 : tenths == 640 ? std::numeric_limits<double>::infinity() : 0;
  if (tenths != 640) return;
  if (has('P')) core_.corner_tolerance_mm = unit_ * std::abs(use('P'));
  if (has('Q')) use('Q');
}

void WordReader::take_m(int code, Request& request) {
  if (code <= 2 || code == 30 || code == 60 || code == 98 || code == 99)
    request.stop = code;
  else if (code <= 5)
    request.spindle = code;
  else if (code == 6)
    request.change = true;
  else if (code <= 9)
    request.coolant = code;
  else if (code >= 428)
    request.tcp = code == 428;
  else if (code >= 70 && code <= 73)
    request.keep = code;
  else if (code >= 50)
    request.signal = code;
}

}  // namespace lightmill::detail
