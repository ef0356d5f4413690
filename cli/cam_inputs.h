// What the cam stage plans with besides the surface, from the job: blank, border of the finishing, land, cut-out.
#pragma once

#include <optional>

#include "cam/outline.h"
#include "cam/reachable.h"
#include "cli/job.h"

namespace lightmill {

/// The lowest blank that holds the lens, up to the next 0.1 mm.
double least_blank_mm(const SplineSurface& surface);

/// The part and its margin; as high as given, or as the highest point of the lens and the allowance ask for, up to the next
/// 0.1 mm. Throws InputError where the given height is too low.
Blank blank_of(const Job& job, const SplineSurface& surface);

/// What semi-finishing and finishing keep within; a rectangle as large as its blank is finished from beside it to beside it.
std::optional<Outline> finishing_border(const Job& job, const Outline& outline);

/// Height of the land, below the lowest place of the lens's border.
double land_z_mm(const Job& job, const SplineSurface& surface, const Outline& outline);

/// Out of the finishing ball's reach, on a grid fine enough for its fillets. Throws InputError where the lens is too large for
/// such a grid.
ReachableSurface reachable_by_finishing(const Job& job, const SplineSurface& surface, const Outline& outline, const Monitor& monitor = {});

ProfileOptions profile_options(const Job& job, const SplineSurface& surface, const Outline& outline);

}  // namespace lightmill
