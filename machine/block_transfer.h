// Heidenhain's FE protocol: a program goes to the control's disk block by block, each with a check character.
#pragma once

#include <chrono>
#include <functional>
#include <string>
#include <string_view>

#include "design/core/monitor.h"
#include "machine/connection.h"
#include "machine/streamer.h"

namespace lightmill {

struct BlockTransferOptions {
  std::chrono::milliseconds start_timeout{120'000};  ///< for the control to ask: its operator starts reading in
  std::chrono::milliseconds reply_timeout{5000};
  int most_repeats = 3;          ///< of one block, when the control refuses it
  bool printable_check = false;  ///< MP5020 bit 1: the check character is no control character
  std::function<void(const std::string&)> on_traffic;
};

/// Waits until the control asks for a program, then sends it line by line (blanks around them and blank lines left
/// out), each acknowledged before the next. A refused block is repeated; everything else that is not an acknowledgement
/// in its time ends the transfer: nothing has moved, and the operator reads in again from the start. Throws InputError,
/// before anything is sent, for characters that seven bits do not hold.
StreamResult transfer_blockwise(Connection& connection, std::string_view program,
                                const BlockTransferOptions& options = {}, const Monitor& monitor = {});

}  // namespace lightmill
