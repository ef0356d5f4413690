// How fast a program wants to be read, against what the control and the link can do.
#pragma once

#include <span>
#include <string>

#include "postproc/machine_model.h"

namespace lightmill {

struct DataRate {
  double bytes_per_block = 0;
  double mean_blocks_per_s = 0;     ///< of the feed moves
  double peak_blocks_per_s = 0;     ///< over any stretch as long as the control's look-ahead
  double control_blocks_per_s = 0;  ///< 1 / min_block_s; 0: not known
  double link_blocks_per_s = 0;     ///< at the line's speed, a tenth of it spare; 0: run from the control's own disk
  double starved_share = 0;         ///< of the cutting time, in stretches that want more than control and link give
  std::string remedy;               ///< empty: nothing to do
};

/// Of a line that brings the wanted blocks a second, 10 bits a byte and a tenth of it spare.
double wanted_baud(double wanted_per_s, double bytes_per_block);
/// The slowest usual line that brings the wanted blocks a second, a tenth of it spare; 0: none does.
int least_baud(double wanted_per_s, double bytes_per_block);

/// `feed_seconds`: planned, of each block that feeds. `baud` of the link by which the program is fed while it runs, 10 bits a byte; 0: from the control's disk.
DataRate data_rate(const MachineModel& machine, std::span<const double> feed_seconds, std::size_t bytes,
                   std::size_t blocks, int baud);

}  // namespace lightmill
