#include "design/detail/compound_energy.h"

#include <ceres/ceres.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <thread>

#include "design/core/errors.h"
#include "design/core/one_blas_thread.h"
#include "design/core/parallel.h"

namespace lightmill::detail {

namespace {

Eigen::Matrix3d cross_matrix(const Vec3& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

/// The height part of E_reg costs a right surface nothing, so it can be this much heavier than the part in the plane:
/// enough to keep checkerboards, which angle-weighted normals hardly see, out of the light (portrait at mesh 321:
/// streaks gone, l1_error the same within 2e-4).
constexpr double kHeightSmoothness = 1000;

using RowMatrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using RowMatrix23 = Eigen::Matrix<double, 2, 3, Eigen::RowMajor>;

}  // namespace

bool has_say(std::uint32_t crossed, int triangle_count, int k) {
  const std::uint32_t all = triangle_count >= 32 ? ~std::uint32_t{0} : (std::uint32_t{1} << triangle_count) - 1;
  return (crossed & all) == all || (crossed >> (k % 32) & 1) == 0;
}

EnergyScales::EnergyScales(const CompoundEnergy& energy)
    : integration(std::sqrt(energy.weights.integration) / energy.slope_scale),
      direction(std::sqrt(energy.weights.direction) / energy.edge_mm),
      flux(std::sqrt(energy.weights.flux)),
      smoothness(std::sqrt(energy.weights.smoothness) / energy.edge_mm),
      height_smoothness(std::sqrt(kHeightSmoothness) * smoothness),
      barrier(std::sqrt(energy.weights.barrier)) {}

Vec3 ring_normal(const Vec3& centre, const std::vector<Vec3>& ring, bool closed, std::uint32_t crossed,
                 std::vector<Eigen::Matrix3d>* jacobians) {
  const int count = static_cast<int>(ring.size());
  const int triangle_count = closed ? count : count - 1;
  Vec3 sum = Vec3::Zero();
  if (jacobians) jacobians->assign(count + 1, Eigen::Matrix3d::Zero());
  for (int k = 0; k < triangle_count; ++k) {
    if (!has_say(crossed, triangle_count, k)) continue;
    const int next = k + 1 == count ? 0 : k + 1;
    const Vec3 u = ring[k] - centre;
    const Vec3 w = ring[next] - centre;
    const Vec3 c = u.cross(w);
    const double area = c.norm();
    if (area == 0) continue;
    const Vec3 n = c / area;
    const double angle = std::atan2(area, u.dot(w));
    sum += angle * n;
    if (!jacobians) continue;
    // The face normal turns with c; the angle closes when u turns towards w.
    const Eigen::Matrix3d turn = (angle / area) * (Eigen::Matrix3d::Identity() - n * n.transpose());
    const Eigen::Matrix3d by_u = -turn * cross_matrix(w) - n * (n.cross(u) / u.squaredNorm()).transpose();
    const Eigen::Matrix3d by_w = turn * cross_matrix(u) + n * (n.cross(w) / w.squaredNorm()).transpose();
    (*jacobians)[k + 1] += by_u;
    (*jacobians)[next + 1] += by_w;
    (*jacobians)[0] -= by_u + by_w;
  }
  const double length = sum.norm();
  if (length == 0) return Vec3::UnitZ();
  const Vec3 normal = sum / length;
  if (jacobians) {
    const Eigen::Matrix3d scale = (Eigen::Matrix3d::Identity() - normal * normal.transpose()) / length;
    for (auto& j : *jacobians) j = scale * j;
  }
  return normal;
}

namespace {

/// E_int [paper eq. 6]: the vertex's angle-weighted normal against its target. Parameters: the vertex, then its ring.
class NormalCost : public ceres::CostFunction {
 public:
  NormalCost(const Vec3& target, int neighbours, bool closed, std::uint32_t crossed, double weight)
      : target_(target), closed_(closed), crossed_(crossed), weight_(weight) {
    set_num_residuals(3);
    mutable_parameter_block_sizes()->assign(neighbours + 1, 3);
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const int neighbours = static_cast<int>(parameter_block_sizes().size()) - 1;
    thread_local std::vector<Vec3> ring;
    thread_local std::vector<Eigen::Matrix3d> derivatives;
    ring.resize(neighbours);
    for (int k = 0; k < neighbours; ++k) ring[k] = Eigen::Map<const Vec3>(parameters[k + 1]);
    const Vec3 normal =
        ring_normal(Eigen::Map<const Vec3>(parameters[0]), ring, closed_, crossed_, jacobians ? &derivatives : nullptr);
    Eigen::Map<Vec3>{residuals} = weight_ * (normal - target_);
    if (jacobians) {
      for (int k = 0; k <= neighbours; ++k) {
        if (jacobians[k]) Eigen::Map<RowMatrix3>{jacobians[k]} = weight_ * derivatives[k];
      }
    }
    return true;
  }

 private:
  Vec3 target_;
  bool closed_;
  std::uint32_t crossed_;
  double weight_;
};

/// E_dir [paper eq. 7]: the way from the vertex to the line of its ray, across the ray.
class DirectionCost : public ceres::SizedCostFunction<2, 3> {
 public:
  DirectionCost(const Vec3& on_ray, const Vec3& direction, double weight) : on_ray_(on_ray) {
    const Vec3 across = direction.unitOrthogonal();
    across_.row(0) = weight * across;
    across_.row(1) = weight * direction.cross(across);
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    Eigen::Map<Vec2>{residuals} = across_ * (Eigen::Map<const Vec3>(parameters[0]) - on_ray_);
    if (jacobians && jacobians[0]) Eigen::Map<RowMatrix23>{jacobians[0]} = across_;
    return true;
  }

 private:
  Vec3 on_ray_;
  RowMatrix23 across_;
};

/// E_flux [paper eq. 8]: the light through a triangle. Over the little way that a vertex slides the light does not
/// change, only the area that meets it does.
class FluxCost : public ceres::SizedCostFunction<1, 3, 3, 3> {
 public:
  FluxCost(const Vec3& flux_per_mm2, double wanted, double weight)
      : flux_(flux_per_mm2), wanted_(wanted), weight_(weight) {}

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const auto at = [&](int k) { return Eigen::Map<const Vec3>(parameters[k % 3]); };
    residuals[0] = weight_ * (flux_.dot((at(1) - at(0)).cross(at(2) - at(0))) / 2 - wanted_);
    if (jacobians) {
      for (int k = 0; k < 3; ++k) {
        if (jacobians[k]) Eigen::Map<Vec3>{jacobians[k]} = weight_ / 2 * (at(k + 1) - at(k + 2)).cross(flux_);
      }
    }
    return true;
  }

 private:
  Vec3 flux_;
  double wanted_;
  double weight_;
};

/// E_reg [paper eq. 9], in the plane: the combinatorial Laplacian of x and y over the given neighbours.
class PlanarSmoothnessCost : public ceres::CostFunction {
 public:
  PlanarSmoothnessCost(int neighbours, const Vec2& rest, double weight) : rest_(rest), weight_(weight) {
    set_num_residuals(2);
    mutable_parameter_block_sizes()->assign(neighbours + 1, 3);
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const int neighbours = static_cast<int>(parameter_block_sizes().size()) - 1;
    for (int axis = 0; axis < 2; ++axis) {
      double sum = -rest_[axis];
      for (int k = 1; k <= neighbours; ++k) sum += parameters[k][axis] - parameters[0][axis];
      residuals[axis] = weight_ * sum;
    }
    if (jacobians) {
      for (int k = 0; k <= neighbours; ++k) {
        if (!jacobians[k]) continue;
        const double d = k == 0 ? -weight_ * neighbours : weight_;
        Eigen::Map<Eigen::Matrix<double, 2, 3, Eigen::RowMajor>>{jacobians[k]} << d, 0, 0, 0, d, 0;
      }
    }
    return true;
  }

 private:
  Vec2 rest_;
  double weight_;
};

/// E_reg along z: the Laplacian of the heights, less what the wanted slopes ask it to be (trapezoidal rule). A smooth
/// lens, however strongly curved, costs nothing; what no vertex normal can see (a checkerboard of heights) does.
class HeightSmoothnessCost : public ceres::CostFunction {
 public:
  HeightSmoothnessCost(std::vector<Vec2> mean_slopes, double weight)
      : slopes_(std::move(mean_slopes)), weight_(weight) {
    set_num_residuals(1);
    mutable_parameter_block_sizes()->assign(slopes_.size() + 1, 3);
    for (const Vec2& s : slopes_) sum_ += s;
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const double* centre = parameters[0];
    double sum = 0;
    for (std::size_t k = 0; k < slopes_.size(); ++k) {
      const double* p = parameters[k + 1];
      sum += p[2] - centre[2] - slopes_[k].x() * (p[0] - centre[0]) - slopes_[k].y() * (p[1] - centre[1]);
    }
    residuals[0] = weight_ * sum;
    if (jacobians) {
      if (jacobians[0]) {
        Eigen::Map<Vec3>{jacobians[0]} = weight_ * Vec3(sum_.x(), sum_.y(), -static_cast<double>(slopes_.size()));
      }
      for (std::size_t k = 0; k < slopes_.size(); ++k) {
        if (jacobians[k + 1]) Eigen::Map<Vec3>{jacobians[k + 1]} = weight_ * Vec3(-slopes_[k].x(), -slopes_[k].y(), 1);
      }
    }
    return true;
  }

 private:
  std::vector<Vec2> slopes_;
  Vec2 sum_ = Vec2::Zero();
  double weight_;
};

/// E_bar [paper eq. 10, 11]: nothing above the floor, -log(1 + height above it) below; from half a unit below on along
/// the tangent, so that it has a value wherever a step lands.
class BarrierCost : public ceres::SizedCostFunction<1, 3> {
 public:
  BarrierCost(double floor_mm, double unit_mm, double weight) : floor_(floor_mm), unit_(unit_mm), weight_(weight) {}

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const double above = (parameters[0][2] - floor_) / unit_;
    double value = 0;
    double slope = 0;
    if (above < -0.5) {
      slope = -2;
      value = std::log(2.0) - 2 * (above + 0.5);
    } else if (above < 0) {
      slope = -1 / (1 + above);
      value = -std::log1p(above);
    }
    residuals[0] = weight_ * value;
    if (jacobians && jacobians[0]) Eigen::Map<Vec3>{jacobians[0]} = Vec3(0, 0, weight_ * slope / unit_);
    return true;
  }

 private:
  double floor_;
  double unit_;
  double weight_;
};

/// A border vertex on a straight side: along the side, and up.
class SideManifold : public ceres::Manifold {
 public:
  explicit SideManifold(const Vec2& side) : side_(side) {}
  int AmbientSize() const override { return 3; }
  int TangentSize() const override { return 2; }
  bool Plus(const double* x, const double* delta, double* result) const override {
    for (int axis = 0; axis < 2; ++axis) result[axis] = x[axis] + side_[axis] * delta[0];
    result[2] = x[2] + delta[1];
    return true;
  }
  bool PlusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<Eigen::Matrix<double, 3, 2, Eigen::RowMajor>>{jacobian} << side_.x(), 0, side_.y(), 0, 0, 1;
    return true;
  }
  bool Minus(const double* y, const double* x, double* delta) const override {
    delta[0] = side_.x() * (y[0] - x[0]) + side_.y() * (y[1] - x[1]);
    delta[1] = y[2] - x[2];
    return true;
  }
  bool MinusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<RowMatrix23>{jacobian} << side_.x(), side_.y(), 0, 0, 0, 1;
    return true;
  }

 private:
  Vec2 side_;
};

/// Reports every step, and ends the minimisation when the user wants to stop.
class StopCallback : public ceres::IterationCallback {
 public:
  StopCallback(const Monitor& monitor, int iterations) : monitor_(monitor), iterations_(std::max(1, iterations)) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary& summary) override {
    if (monitor_.on_progress) {
      monitor_.on_progress("integrating normals", std::min(1.0, static_cast<double>(summary.iteration) / iterations_));
    }
    stopped = monitor_.should_stop && monitor_.should_stop();
    return stopped ? ceres::SOLVER_ABORT : ceres::SOLVER_CONTINUE;
  }
  bool stopped = false;

 private:
  const Monitor& monitor_;
  int iterations_;
};

/// The mean slopes over a vertex's edges that the wanted slopes ask for, in ring order.
std::vector<Vec2> mean_slopes(const CompoundEnergy& energy, int v) {
  std::vector<Vec2> slopes;
  for (int n : energy.rings[v].neighbours) slopes.push_back(energy.mean_slope(v, n));
  return slopes;
}

/// Adds the terms that any vertex free to move takes part in.
void add_terms(const CompoundEnergy& energy, std::vector<Vec3>& positions, ceres::Problem& problem) {
  const int count = static_cast<int>(positions.size());
  const EnergyScales scales(energy);
  const auto moves = [&](int v) { return energy.freedom[v] != Freedom::kNone; };
  const auto slides = [&](int v) { return energy.freedom[v] > Freedom::kHeight; };
  std::vector<char> concerned(count, 0);  // itself or a neighbour moves
  for (int v = 0; v < count; ++v) {
    concerned[v] |= moves(v);
    for (int n : energy.rings[v].neighbours) concerned[v] |= moves(n);
  }
  std::vector<double*> blocks;
  for (int v = 0; v < count; ++v) {
    const OneRing& ring = energy.rings[v];
    if (!concerned[v] || ring.neighbours.empty()) continue;
    const int neighbours = static_cast<int>(ring.neighbours.size());
    blocks.assign(1, positions[v].data());
    for (int n : ring.neighbours) blocks.push_back(positions[n].data());
    problem.AddResidualBlock(new NormalCost(energy.target_normals[v], neighbours, ring.closed,
                                            energy.creases.crossed[v], scales.integration),
                             nullptr, blocks);
    if (scales.smoothness > 0) {
      problem.AddResidualBlock(new HeightSmoothnessCost(mean_slopes(energy, v), scales.height_smoothness), nullptr,
                               blocks);
      // On the border only the neighbours along the border count: the others would pull the outline inwards.
      bool planar = slides(v);
      for (int n : ring.neighbours) planar |= slides(n);
      if (planar) {
        if (!ring.closed)
          blocks = {blocks[0], positions[ring.neighbours.front()].data(), positions[ring.neighbours.back()].data()};
        Vec2 rest = Vec2::Zero();  // of the start mesh: it is at rest
        for (std::size_t k = 0; k < ring.neighbours.size(); ++k) {
          if (!ring.closed && k != 0 && k + 1 != ring.neighbours.size()) continue;
          rest += (energy.start_mm[ring.neighbours[k]] - energy.start_mm[v]).head<2>();
        }
        problem.AddResidualBlock(new PlanarSmoothnessCost(static_cast<int>(blocks.size()) - 1, rest, scales.smoothness),
                                 nullptr, blocks);
      }
    }
    if (scales.direction > 0 && slides(v)) {
      problem.AddResidualBlock(new DirectionCost(energy.start_mm[v], energy.light[v].direction, scales.direction),
                               nullptr, positions[v].data());
    }
    if (scales.barrier > 0 && moves(v)) {
      problem.AddResidualBlock(new BarrierCost(energy.floor_mm, energy.edge_mm, scales.barrier), nullptr,
                               positions[v].data());
    }
  }
  if (!(scales.flux > 0)) return;
  std::vector<Vec3> flux_per_mm2;
  std::vector<double> flux;
  double mean_flux = 0;
  for (const auto& t : energy.triangles) {
    const Vec3& a = energy.start_mm[t[0]];
    flux_per_mm2.push_back((energy.light[t[0]].flux + energy.light[t[1]].flux + energy.light[t[2]].flux) / 3);
    flux.push_back(flux_per_mm2.back().dot((energy.start_mm[t[1]] - a).cross(energy.start_mm[t[2]] - a)) / 2);
    mean_flux += flux.back() / static_cast<double>(energy.triangles.size());
  }
  for (std::size_t t = 0; t < energy.triangles.size(); ++t) {
    const auto& corners = energy.triangles[t];
    if (!slides(corners[0]) && !slides(corners[1]) && !slides(corners[2])) continue;
    problem.AddResidualBlock(new FluxCost(flux_per_mm2[t], flux[t], scales.flux / mean_flux), nullptr,
                             positions[corners[0]].data(), positions[corners[1]].data(), positions[corners[2]].data());
  }
}

ceres::Problem::Options problem_options() {
  ceres::Problem::Options options;
  options.enable_fast_removal = false;
  options.disable_all_safety_checks = true;
  return options;
}

}  // namespace

MinimiserReport minimise(const CompoundEnergy& energy, int iterations, double trust_radius,
                         std::vector<Vec3>& positions, const Monitor& monitor) {
  ceres::Problem problem(problem_options());
  add_terms(energy, positions, problem);
  for (std::size_t v = 0; v < positions.size(); ++v) {
    double* block = positions[v].data();
    if (!problem.HasParameterBlock(block)) continue;
    switch (energy.freedom[v]) {
      case Freedom::kNone:
        problem.SetParameterBlockConstant(block);
        break;
      case Freedom::kHeight:
        problem.SetManifold(block, new ceres::SubsetManifold(3, {0, 1}));
        break;
      case Freedom::kHeightAndSide:
        problem.SetManifold(block, new SideManifold(energy.sides[v]));
        break;
      case Freedom::kAll:
        break;
    }
  }
  ceres::Solver::Options options;
  options.minimizer_type = ceres::TRUST_REGION;
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  options.sparse_linear_algebra_library_type = ceres::SUITE_SPARSE;
  options.num_threads = std::min(thread_count(), std::max(1, static_cast<int>(std::thread::hardware_concurrency())));
  options.max_num_iterations = iterations;
  // Heights of the lens's own size are soft against the heights of single vertices: a small trust region would hold
  // them.
  options.initial_trust_region_radius = trust_radius;
  options.function_tolerance = 1e-7;
  options.gradient_tolerance = 1e-16;
  options.parameter_tolerance = 1e-14;
  options.logging_type = ceres::SILENT;
  StopCallback stop(monitor, iterations);
  options.callbacks.push_back(&stop);
  const OneBlasThread one_blas_thread;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  if (stop.stopped) throw Stopped();
  if (!summary.IsSolutionUsable()) throw NumericalError("surface: Ceres found no solution: " + summary.message);
  return {.initial_energy = summary.initial_cost,
          .final_energy = summary.final_cost,
          .iterations = static_cast<int>(summary.iterations.size()) - 1,
          .message = summary.message};
}

double energy_at(const CompoundEnergy& energy, std::vector<Vec3>& positions, std::vector<Vec3>& gradient) {
  ceres::Problem problem(problem_options());
  add_terms(energy, positions, problem);
  double cost = 0;
  std::vector<double> flat;
  ceres::Problem::EvaluateOptions options;
  for (Vec3& p : positions) options.parameter_blocks.push_back(p.data());
  problem.Evaluate(options, &cost, nullptr, &flat, nullptr);
  gradient.clear();
  for (std::size_t v = 0; v < positions.size(); ++v) gradient.emplace_back(Eigen::Map<const Vec3>(&flat[3 * v]));
  return cost;
}

}  // namespace lightmill::detail
