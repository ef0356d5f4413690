// The transport from samples of the source that are already there.
#pragma once

#include <vector>

#include "design/detail/sampling.h"
#include "design/transport.h"

namespace lightmill::detail {

/// solve_transport after its sampling: `levels` are the finest samples first, then coarser ones. The order of the
/// samples changes the result within the tolerances only.
TransportMap solve_sampled(const std::vector<Sampling>& levels, const TargetLight& target,
                           const TransportOptions& options, const Monitor& monitor);

}  // namespace lightmill::detail
