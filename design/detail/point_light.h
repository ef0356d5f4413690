// Points of light, whose flux no power cell can cut: shared among sites by a softmax.
#pragma once

#include <vector>

#include "design/core/geometry.h"

namespace lightmill::detail {

struct TargetMeasure;

/// What a point gives to a site. With softness e, in mm^2, a point at x of flux f gives site i
///   f exp((x.s_i - psi_i) / e) / sum_j exp((x.s_j - psi_j) / e),
/// which is the gradient of the smooth f e log sum_j exp((x.s_j - psi_j) / e). As e goes to 0 that is f times the highest
/// of the x.s_j - psi_j, a point's part in the dual [paper eq. 3]: sites whose power cells meet at x share it.
struct PointShare {
  int point;
  int site;
  double mass;
};

/// Softness of the points in a measure, mm^2.
double softness(const TargetMeasure& measure);

/// All shares that matter beside rounding, point by point.
std::vector<PointShare> share_points(const TargetMeasure& measure, const std::vector<Vec2>& sites,
                                     const std::vector<double>& psi);

/// What the dual has beside sum_i m_i (x.s_i - psi_i) for the masses m_i that points give: -e sum_i m_i log(m_i / f).
double points_entropy(const TargetMeasure& measure, const std::vector<PointShare>& shares);

/// Raises the potentials of sites that take far more from a point than they are to have, all of them together, so that the
/// point's flux fills one after the other: the nearest ones whole, others less, none too much. Returns whether any did.
bool level_points(const TargetMeasure& measure, const std::vector<Vec2>& sites, const std::vector<double>& wanted,
                  const std::vector<PointShare>& shares, std::vector<double>& psi);

/// What the points give to one site after the other while their potentials change.
class PointPull {
 public:
  PointPull(const TargetMeasure& measure, const std::vector<Vec2>& sites, const std::vector<double>& psi);

  /// What the site, now at potential psi, would have at `potential`.
  [[nodiscard]] double mass(int site, double psi, double potential) const;
  /// The highest potential at which one of the points alone gives `wanted`; -infinity when none has that much.
  [[nodiscard]] double potential_for(int site, double psi, double wanted) const;
  /// The site's potential has changed.
  void move(int site, double psi, double potential);

 private:
  /// log sum exp over the other sites.
  [[nodiscard]] double others(std::size_t point, int site, double psi) const;
  [[nodiscard]] double pull(std::size_t point, int site, double potential) const;

  const TargetMeasure& measure_;
  const std::vector<Vec2>& sites_;
  double softness_;
  std::vector<double> level_;  // of each point: log sum exp
};

}  // namespace lightmill::detail
