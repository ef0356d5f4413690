#include "cam/finishing.h"

#include "cam/detail/ball_contact.h"

namespace lightmill {

double ball_centre_height(const SplineSurface& surface, double radius_mm, double x, double y) {
  return detail::ball_contact(surface, radius_mm, x, y).z;
}

}  // namespace lightmill
