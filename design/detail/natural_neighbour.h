// Natural neighbours (Sibson) of places among scattered sites in the plane.
#pragma once

#include <functional>
#include <memory>
#include <utility>
#include <vector>

#include "design/core/geometry.h"

namespace lightmill::detail {

/// A site's number and its share of a place: the area that the place's Voronoi cell would take from the site's
/// [Sibson 1981]. The shares of a place sum to 1; interpolation with them is exact for linear data.
using SiteShare = std::pair<int, double>;

/// The Delaunay triangulation of sites. Needs three that are not on a line; throws NumericalError otherwise.
class NaturalNeighbours {
 public:
  explicit NaturalNeighbours(const std::vector<Vec2>& sites);
  ~NaturalNeighbours();
  NaturalNeighbours(NaturalNeighbours&&) noexcept;

  /// Calls visit(query's index, shares) for all queries, on all threads. A query outside the hull of the sites has the
  /// nearest site alone.
  void each(const std::vector<Vec2>& queries,
            const std::function<void(std::size_t, const std::vector<SiteShare>&)>& visit) const;

  /// The sites that share a Delaunay edge with each site.
  [[nodiscard]] std::vector<std::vector<int>> adjacent() const;

 private:
  struct Delaunay;
  std::unique_ptr<Delaunay> delaunay_;
};

/// Values at sites interpolated to queries.
std::vector<Vec2> natural_neighbour_interpolation(const std::vector<Vec2>& sites, const std::vector<Vec2>& values,
                                                  const std::vector<Vec2>& queries);

}  // namespace lightmill::detail
