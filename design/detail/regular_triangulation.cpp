#include "design/detail/regular_triangulation.h"

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Regular_triangulation_2.h>
#include <CGAL/Spatial_sort_traits_adapter_2.h>
#include <CGAL/Triangulation_face_base_with_info_2.h>
#include <CGAL/Triangulation_vertex_base_with_info_2.h>
#include <CGAL/property_map.h>
#include <CGAL/spatial_sort.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "design/core/parallel.h"

namespace lightmill::detail {

namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using WeightedPoint = Kernel::Weighted_point_2;

constexpr std::size_t kBlock = 4096;

struct Lifted {
  double x, y, w;
};

/// Sign of the power of t with respect to the orthogonal circle of the counter-clockwise p, q, r, positive inside; 0 when
/// rounding may have decided.
int filtered_power_side(const Lifted& p, const Lifted& q, const Lifted& r, const Lifted& t) {
  struct Row {
    double x, y, z;
    double largest;  // of the terms that z is summed from, added up
  };
  const auto row = [&t](const Lifted& a) -> Row {
    const double x = a.x - t.x;
    const double y = a.y - t.y;
    const double square = x * x + y * y;
    return {x, y, square - a.w + t.w, square + std::abs(a.w) + std::abs(t.w)};
  };
  const Row a = row(p);
  const Row b = row(q);
  const Row c = row(r);
  const double determinant =
      a.z * (b.x * c.y - b.y * c.x) + b.z * (c.x * a.y - c.y * a.x) + c.z * (a.x * b.y - a.y * b.x);
  const double x = std::max({std::abs(a.x), std::abs(b.x), std::abs(c.x)});
  const double y = std::max({std::abs(a.y), std::abs(b.y), std::abs(c.y)});
  const double z = std::max({a.largest, b.largest, c.largest});
  // Six products of at most x y z, each with at most twelve roundings of 2^-53 relative to that bound, make 8e-15.
  const double bound = 2e-14 * x * y * z;
  return determinant > bound ? 1 : determinant < -bound ? -1 : 0;
}

Lifted lifted(const WeightedPoint& p) {
  return {p.x(), p.y(), p.weight()};
}

/// The kernel with the floating-point filter before its power test, which has none of its own but interval arithmetic.
struct FilteredTraits : Kernel {
  struct Power_side_of_oriented_power_circle_2 : Kernel::Power_side_of_oriented_power_circle_2 {
    using Base = Kernel::Power_side_of_oriented_power_circle_2;
    using Base::operator();
    CGAL::Oriented_side operator()(const WeightedPoint& p, const WeightedPoint& q, const WeightedPoint& r,
                                   const WeightedPoint& t) const {
      const int side = filtered_power_side(lifted(p), lifted(q), lifted(r), lifted(t));
      if (side != 0) return side > 0 ? CGAL::ON_POSITIVE_SIDE : CGAL::ON_NEGATIVE_SIDE;
      return Base::operator()(p, q, r, t);
    }
  };
  [[nodiscard]] Power_side_of_oriented_power_circle_2 power_side_of_oriented_power_circle_2_object() const {
    return {};
  }
};

using VertexBase =
    CGAL::Regular_triangulation_vertex_base_2<FilteredTraits, CGAL::Triangulation_vertex_base_with_info_2<int, Kernel>>;
using FaceBase =
    CGAL::Regular_triangulation_face_base_2<FilteredTraits, CGAL::Triangulation_face_base_with_info_2<int, Kernel>>;
using CgalTriangulation =
    CGAL::Regular_triangulation_2<FilteredTraits, CGAL::Triangulation_data_structure_2<VertexBase, FaceBase>>;

constexpr int next(int k) {
  return k == 2 ? 0 : k + 1;
}
constexpr int previous(int k) {
  return k == 0 ? 2 : k - 1;
}

int index_of(const std::array<int, 3>& three, int value) {
  return three[0] == value ? 0 : three[1] == value ? 1 : 2;
}

}  // namespace

RegularTriangulation::RegularTriangulation(std::vector<Vec2> sites, int corners)
    : sites_(std::move(sites)), corners_(corners) {
  std::vector<Kernel::Point_2> points;
  points.reserve(sites_.size());
  for (const auto& s : sites_) points.emplace_back(s.x(), s.y());
  order_.resize(sites_.size() - corners_);
  std::iota(order_.begin(), order_.end(), std::size_t{0});
  using Map = CGAL::Pointer_property_map<Kernel::Point_2>::type;
  using Traits = CGAL::Spatial_sort_traits_adapter_2<Kernel, Map>;
  CGAL::spatial_sort(order_.begin(), order_.end(), Traits(CGAL::make_property_map(points)));
}

void RegularTriangulation::update(const std::vector<double>& weights) {
  weights_ = weights;
  if (triangles_.empty() || !repair()) build();
}

void RegularTriangulation::build() {
  const int all = static_cast<int>(sites_.size());
  CgalTriangulation triangulation;
  CgalTriangulation::Face_handle hint;
  triangle_of_.assign(all, -1);
  hidden_.clear();
  const auto insert = [&](int i) {
    const auto vertex =
        triangulation.insert({Kernel::Point_2(sites_[i].x(), sites_[i].y()), weights_[i]}, hint);
    if (vertex == CgalTriangulation::Vertex_handle()) {
      hidden_.push_back(i);  // a site twice, with the smaller weight
      return;
    }
    vertex->info() = i;
    if (!vertex->is_hidden()) hint = vertex->face();
  };
  for (int i = all - corners_; i < all; ++i) insert(i);
  for (const std::size_t i : order_) insert(static_cast<int>(i));

  for (const auto face : triangulation.all_face_handles()) face->info() = -1;
  int count = 0;
  for (const auto face : triangulation.finite_face_handles()) face->info() = count++;
  triangles_.assign(count, {});
  free_.clear();
  for (const auto face : triangulation.finite_face_handles()) {
    Triangle& t = triangles_[face->info()];
    for (int k = 0; k < 3; ++k) {
      t.corners[k] = face->vertex(k)->info();
      t.neighbours[k] = face->neighbor(k)->info();
      triangle_of_[t.corners[k]] = face->info();
    }
  }
  for (auto v = triangulation.hidden_vertices_begin(); v != triangulation.hidden_vertices_end(); ++v) {
    const int site = v->info();
    hidden_.push_back(site);
    for (int k = 0; k < 3; ++k) {
      if (!triangulation.is_infinite(v->face()->vertex(k))) triangle_of_[site] = -1 - v->face()->vertex(k)->info();
    }
  }
  for (const int site : hidden_) {
    if (triangle_of_[site] == -1) triangle_of_[site] = -1 - (all - 1);
  }
  std::sort(hidden_.begin(), hidden_.end());
}

bool RegularTriangulation::repair() {
  queue_ = irregular_edges();
  stuck_ = false;
  constexpr int kMostRounds = 20;
  for (int round = 0; round < kMostRounds; ++round) {
    if (!legalise()) break;
    if (!insert_hidden()) return !stuck_ || irregular_edges().empty();
  }
  return false;
}

int RegularTriangulation::orientation(int a, int b, int c) const {
  const auto point = [this](int i) { return Kernel::Point_2(sites_[i].x(), sites_[i].y()); };
  return static_cast<int>(Kernel().orientation_2_object()(point(a), point(b), point(c)));
}

bool RegularTriangulation::in_conflict(const Triangle& t, int site) const {
  const auto lift = [this](int i) -> Lifted { return {sites_[i].x(), sites_[i].y(), weights_[i]}; };
  const int side = filtered_power_side(lift(t.corners[0]), lift(t.corners[1]), lift(t.corners[2]), lift(site));
  if (side != 0) return side > 0;
  const auto exact = [this](int i) {
    return WeightedPoint(Kernel::Point_2(sites_[i].x(), sites_[i].y()), weights_[i]);
  };
  return Kernel().power_side_of_oriented_power_circle_2_object()(exact(t.corners[0]), exact(t.corners[1]), exact(t.corners[2]),
                                                                 exact(site)) == CGAL::ON_POSITIVE_SIDE;
}

bool RegularTriangulation::regular(int triangle, int opposite) const {
  const Triangle& t = triangles_[triangle];
  const int other = t.neighbours[opposite];
  if (other < 0) return true;
  const Triangle& u = triangles_[other];
  return !in_conflict(t, u.corners[index_of(u.neighbours, triangle)]);
}

std::vector<RegularTriangulation::Edge> RegularTriangulation::irregular_edges() const {
  const std::size_t blocks = (triangles_.size() + kBlock - 1) / kBlock;
  std::vector<std::vector<Edge>> found(blocks);
  parallel_blocks(triangles_.size(), kBlock, [&](std::size_t begin, std::size_t end) {
    auto& edges = found[begin / kBlock];
    for (std::size_t i = begin; i < end; ++i) {
      const Triangle& t = triangles_[i];
      if (!t.alive()) continue;
      for (int k = 0; k < 3; ++k) {
        if (t.neighbours[k] > static_cast<int>(i) && !regular(static_cast<int>(i), k))
          edges.push_back({static_cast<int>(i), k});
      }
    }
  });
  std::vector<Edge> all;
  for (const auto& edges : found) all.insert(all.end(), edges.begin(), edges.end());
  return all;
}

int RegularTriangulation::add(const Triangle& t) {
  int slot = static_cast<int>(triangles_.size());
  if (free_.empty()) {
    triangles_.push_back(t);
  } else {
    slot = free_.back();
    free_.pop_back();
  }
  place(slot, t);
  return slot;
}

void RegularTriangulation::place(int slot, const Triangle& t) {
  triangles_[slot] = t;
  for (const int site : t.corners) triangle_of_[site] = slot;
}

/// Makes `triangle` see `after` where it saw `before`.
void RegularTriangulation::join(int triangle, int before, int after) {
  if (triangle >= 0) triangles_[triangle].neighbours[index_of(triangles_[triangle].neighbours, before)] = after;
}

void RegularTriangulation::push(int triangle) {
  for (int k = 0; k < 3; ++k) queue_.push_back({triangle, k});
}

/// The edge opposite corner k of t gives way to the other diagonal of its quadrilateral.
void RegularTriangulation::flip(int t, int k) {
  const Triangle one = triangles_[t];
  const int u = one.neighbours[k];
  const Triangle two = triangles_[u];
  const int m = index_of(two.neighbours, t);
  const int c = one.corners[k];
  const int a = one.corners[next(k)];
  const int b = one.corners[previous(k)];
  const int d = two.corners[m];
  // Of t: a -> b is the old edge, c on its left; of u: b -> a, d on its left.
  const int bc = one.neighbours[next(k)];
  const int ca = one.neighbours[previous(k)];
  const int ad = two.neighbours[index_of(two.corners, b)];
  const int db = two.neighbours[index_of(two.corners, a)];
  place(t, {{c, a, d}, {ad, u, ca}});
  place(u, {{d, b, c}, {bc, t, db}});
  join(ad, u, t);
  join(bc, t, u);
  push(t);
  push(u);
}

int RegularTriangulation::degree(int site, int triangle) const {
  constexpr int kEnough = 5;
  int count = 0;
  int t = triangle;
  do {
    const int k = index_of(triangles_[t].corners, site);
    t = triangles_[t].neighbours[next(k)];
    ++count;
  } while (t >= 0 && t != triangle && count < kEnough);
  return t < 0 ? kEnough : count;
}

/// Three triangles around a site become one, and the site is hidden.
void RegularTriangulation::remove(int site, int triangle) {
  std::array<int, 3> slots{};
  std::array<int, 3> outer{};
  std::array<int, 3> rim{};
  int t = triangle;
  for (int i = 0; i < 3; ++i) {
    const int k = index_of(triangles_[t].corners, site);
    slots[i] = t;
    rim[i] = triangles_[t].corners[next(k)];
    outer[i] = triangles_[t].neighbours[k];
    t = triangles_[t].neighbours[next(k)];  // across the edge from the site to the last corner: counter-clockwise
  }
  // Triangle i has the rim edge rim[i] -> rim[i + 1], which is opposite rim[i + 2].
  place(slots[0], {{rim[0], rim[1], rim[2]}, {outer[1], outer[2], outer[0]}});
  for (int i = 1; i < 3; ++i) {
    join(outer[i], slots[i], slots[0]);
    triangles_[slots[i]].corners[0] = -1;
    free_.push_back(slots[i]);
  }
  triangle_of_[site] = -1 - rim[0];
  hidden_.push_back(site);
  push(slots[0]);
}

/// A hidden site inside t, or on its border, becomes visible.
void RegularTriangulation::split(int t, int site) {
  const Triangle old = triangles_[t];
  const auto [a, b, c] = old.corners;
  const int u = add({{b, c, site}, {-1, -1, old.neighbours[0]}});
  const int v = add({{c, a, site}, {-1, -1, old.neighbours[1]}});
  place(t, {{a, b, site}, {u, v, old.neighbours[2]}});
  triangles_[u].neighbours = {v, t, old.neighbours[0]};
  triangles_[v].neighbours = {t, u, old.neighbours[1]};
  join(old.neighbours[0], t, u);
  join(old.neighbours[1], t, v);
  push(t);
  push(u);
  push(v);
  // On a border the flat triangle's long edge has to go, regular or not.
  for (const int flat : {t, u, v}) {
    const auto& corners = triangles_[flat].corners;
    if (orientation(corners[0], corners[1], corners[2]) == 0) {
      flip(flat, 2);
      return;
    }
  }
}

/// Flips until no edge in the queue can and should be; false when it does not come to an end.
bool RegularTriangulation::legalise() {
  std::size_t budget = 64 * triangles_.size() + 1024;
  while (!queue_.empty()) {
    const auto [t, k] = queue_.back();
    queue_.pop_back();
    if (budget-- == 0) return false;
    if (!triangles_[t].alive() || regular(t, k)) continue;
    const Triangle& one = triangles_[t];
    const Triangle& two = triangles_[one.neighbours[k]];
    const int c = one.corners[k];
    const int a = one.corners[next(k)];
    const int b = one.corners[previous(k)];
    const int d = two.corners[index_of(two.neighbours, t)];
    const int at_a = orientation(d, c, a);
    const int at_b = orientation(c, d, b);
    if (at_a > 0 && at_b > 0) {
      flip(t, k);
      continue;
    }
    // The quadrilateral is not convex at one end of the edge: that site is hidden once no other triangle holds it.
    const int site = at_a <= 0 ? a : b;
    const int turn = at_a <= 0 ? at_a : at_b;
    const int held = site < static_cast<int>(sites_.size()) - corners_ ? degree(site, t) : 0;
    if (turn < 0 && held == 3) {
      remove(site, t);
    } else if (turn == 0 && held == 4) {
      // It lies on the other diagonal, where a flat triangle is left for a moment.
      flip(t, k);
      remove(site, triangle_of_[site]);
    } else {
      stuck_ = true;  // until flips nearby free it
    }
  }
  return true;
}

/// The triangle that contains a site, by a visibility walk from where it was hidden; -1 when that loses its way.
int RegularTriangulation::locate(int site) const {
  int near = triangle_of_[site];
  for (int i = 0; near < 0; ++i) near = i < 16 ? triangle_of_[-1 - near] : triangle_of_[sites_.size() - 1];
  int from = -1;
  int t = near;
  for (std::size_t i = 0; i < triangles_.size(); ++i) {
    const Triangle& here = triangles_[t];
    int onward = -1;
    for (int k = 0; k < 3; ++k) {
      if (here.neighbours[k] < 0 || here.neighbours[k] == from) continue;
      if (orientation(here.corners[next(k)], here.corners[previous(k)], site) < 0) {
        onward = here.neighbours[k];
        break;
      }
    }
    if (onward < 0) return t;
    from = t;
    t = onward;
  }
  return -1;
}

/// Makes hidden sites visible that the weights have raised above their triangle. True when there were any.
bool RegularTriangulation::insert_hidden() {
  std::vector<int> candidates;
  candidates.swap(hidden_);  // what becomes hidden on the way is added again
  bool inserted = false;
  for (const int site : candidates) {
    const int t = locate(site);
    if (t >= 0 && in_conflict(triangles_[t], site)) {
      split(t, site);
      legalise();
      inserted = true;
    } else {
      if (t >= 0) triangle_of_[site] = -1 - triangles_[t].corners[0];
      hidden_.push_back(site);
    }
  }
  return inserted;
}

std::vector<RegularTriangulation::Hidden> RegularTriangulation::hidden() const {
  std::vector<Hidden> found;
  for (const int site : hidden_) {
    const int triangle = locate(site);
    if (triangle >= 0) found.push_back({site, triangle});
  }
  return found;
}

}  // namespace lightmill::detail
