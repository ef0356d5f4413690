#include "design/detail/picture_loop.h"

#include <Eigen/CholmodSupport>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>

#include "design/core/errors.h"
#include "design/core/one_blas_thread.h"
#include "design/core/parallel.h"
#include "design/detail/light_grid.h"

namespace lightmill::detail {

namespace {

double area_of(const std::array<Vec2, 3>& p) {
  const Vec2 ab = p[1] - p[0];
  const Vec2 ac = p[2] - p[0];
  return (ab.x() * ac.y() - ab.y() * ac.x()) / 2;
}

/// Bilinear between pixel centres, constant beyond the outermost.
double value_at(const Grid<double>& grid, const Vec2& p) {
  const double x = std::clamp(p.x() - 0.5, 0.0, grid.width - 1.0);
  const double y = std::clamp(p.y() - 0.5, 0.0, grid.height - 1.0);
  const int i = static_cast<int>(x);
  const int j = static_cast<int>(y);
  const int right = std::min(i + 1, grid.width - 1);
  const int up = std::min(j + 1, grid.height - 1);
  const double u = x - i;
  const double v = y - j;
  return (1 - v) * ((1 - u) * grid.at(i, j) + u * grid.at(right, j)) + v * ((1 - u) * grid.at(i, up) + u * grid.at(right, up));
}

/// The integral over a triangle of a grid's density times each corner's hat function, by the centroids of similar parts of at
/// most half a pixel.
Vec3 weighed(const Grid<double>& density, const std::array<Vec2, 3>& p) {
  constexpr int kMostParts = 32;  // along an edge: longer ones are streaks
  const double longest = std::max({(p[1] - p[0]).norm(), (p[2] - p[1]).norm(), (p[0] - p[2]).norm()});
  const int parts = static_cast<int>(std::clamp(std::ceil(2 * longest), 1.0, static_cast<double>(kMostParts)));
  const double part = std::abs(area_of(p)) / (parts * parts);
  Vec3 sum = Vec3::Zero();
  for (int i = 0; i < parts; ++i) {
    for (int j = 0; i + j < parts; ++j) {
      for (int inverted = 0; inverted < (i + j + 1 < parts ? 2 : 1); ++inverted) {
        const double offset = (1.0 + inverted) / 3;
        const double u = (i + offset) / parts;
        const double v = (j + offset) / parts;
        sum += part * value_at(density, p[0] + u * (p[1] - p[0]) + v * (p[2] - p[0])) * Vec3(1 - u - v, u, v);
      }
    }
  }
  return sum;
}

}  // namespace

struct PictureLoop::Factor {
  Eigen::CholmodDecomposition<Eigen::SparseMatrix<double>, Eigen::Lower> cholesky;
};

PictureLoop::PictureLoop(const TargetLight& picture, int pixels, const std::vector<std::array<int, 3>>& triangles,
                         std::vector<double> flux, const std::vector<Vec2>& places, const std::vector<Vec2>& targets,
                         const Creases& creases, Seams seams)
    : triangles_(triangles),
      flux_(std::move(flux)),
      gradients_(triangles.size()),
      areas_(triangles.size(), 0.0),
      steered_(triangles.size(), 0),
      extent_(picture.extent),
      factor_(std::make_unique<Factor>()) {
  const Vec2 size = extent_.size();
  const double pixel = size.maxCoeff() / pixels;
  wanted_ = rasterise(picture, std::max(1, static_cast<int>(std::lround(size.x() / pixel))),
                      std::max(1, static_cast<int>(std::lround(size.y() / pixel))));
  judged_.assign(wanted_.values.size(), 1);
  if (!picture.curves.empty() || !picture.points.empty()) {
    constexpr int kBeside = 3;  // pixels that the light of a curve spreads over
    const Grid<double> areas = rasterise_area(picture, wanted_.width, wanted_.height);
    for (int j = 0; j < wanted_.height; ++j) {
      for (int i = 0; i < wanted_.width; ++i) {
        if (!(wanted_.at(i, j) > (1 + 1e-9) * areas.at(i, j))) continue;
        for (int y = std::max(0, j - kBeside); y <= std::min(wanted_.height - 1, j + kBeside); ++y) {
          for (int x = std::max(0, i - kBeside); x <= std::min(wanted_.width - 1, i + kBeside); ++x)
            judged_[static_cast<std::size_t>(y) * wanted_.width + x] = 0;
        }
      }
    }
  }

  const OneBlasThread one_blas_thread;
  constexpr double kLeastStretch = 0.02;  // of the map: light for a curve has none
  constexpr double kStiff = 1e3;          // light for curves: as if the map shrank everything by so much
  constexpr double kHold = 1e-8;          // of the mean diagonal: potentials between creases are known up to constants
  const auto judged_at = [&](const Vec2& p) {
    const int i = static_cast<int>(std::clamp(p.x(), 0.0, wanted_.width - 1.0));
    const int j = static_cast<int>(std::clamp(p.y(), 0.0, wanted_.height - 1.0));
    return judged_[static_cast<std::size_t>(j) * wanted_.width + i] != 0;
  };
  const std::vector<Vec2> aims = in_pixels(targets);
  std::vector<Eigen::Triplet<double>> entries;
  double diagonal = 0;
  for (std::size_t t = 0; t < triangles.size(); ++t) {
    const auto& c = triangles[t];
    const bool torn = creases.torn(c[0], c[1]) || creases.torn(c[1], c[2]) || creases.torn(c[2], c[0]);
    if (torn && seams == Seams::kParted) continue;
    const double area = area_of({places[c[0]], places[c[1]], places[c[2]]});
    if (!(area > 0)) continue;
    Eigen::Matrix2d from, to;
    from << places[c[1]] - places[c[0]], places[c[2]] - places[c[0]];
    to << targets[c[1]] - targets[c[0]], targets[c[2]] - targets[c[0]];
    const Eigen::Matrix2d inverse = from.inverse();
    const std::array<Vec2, 3> gradients = {Vec2(-inverse.row(0) - inverse.row(1)), inverse.row(0), inverse.row(1)};
    // The map is the gradient of a convex function; what is not is rounding.
    const Eigen::Matrix2d map = to * inverse;
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> stretch((map + map.transpose()) / 2);
    // Light for curves would be the shortest way for all that is missing around it.
    const bool judged = judged_at(aims[c[0]]) && judged_at(aims[c[1]]) && judged_at(aims[c[2]]);
    Eigen::Matrix2d softness = kStiff * Eigen::Matrix2d::Identity();
    if (judged) {
      softness = stretch.eigenvectors() * stretch.eigenvalues().cwiseMax(kLeastStretch).cwiseInverse().asDiagonal() *
                 stretch.eigenvectors().transpose();
    }
    softness *= flux_[t];
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        if (c[i] < c[j]) continue;
        const double value = gradients[i].dot(softness * gradients[j]);
        entries.emplace_back(c[i], c[j], value);
        if (i == j) diagonal += value / static_cast<double>(places.size());
      }
    }
    if (torn) continue;
    areas_[t] = area;
    gradients_[t] = gradients;
    steered_[t] = judged;
  }
  const auto count = static_cast<Eigen::Index>(places.size());
  for (Eigen::Index v = 0; v < count; ++v) entries.emplace_back(v, v, diagonal > 0 ? kHold * diagonal : 1.0);
  Eigen::SparseMatrix<double> matrix(count, count);
  matrix.setFromTriplets(entries.begin(), entries.end());
  factor_->cholesky.compute(matrix);
  if (factor_->cholesky.info() != Eigen::Success)
    throw NumericalError("surface: the equations of the picture's errors cannot be factorised");
}

PictureLoop::~PictureLoop() = default;

std::vector<Vec2> PictureLoop::in_pixels(const std::vector<Vec2>& landed_mm) const {
  const Vec2 per_mm(wanted_.width / extent_.size().x(), wanted_.height / extent_.size().y());
  std::vector<Vec2> result;
  result.reserve(landed_mm.size());
  for (const Vec2& p : landed_mm) result.emplace_back((p - extent_.min).cwiseProduct(per_mm));
  return result;
}

PictureLoop::Errors PictureLoop::errors(const std::vector<Vec2>& landed_mm) const {
  const std::vector<Vec2> landed = in_pixels(landed_mm);
  constexpr std::size_t kBlocks = 8;  // with a grid each, summed in order
  const std::size_t block = (triangles_.size() + kBlocks - 1) / kBlocks;
  std::vector<LightGrid> steered(kBlocks, LightGrid(wanted_.width, wanted_.height));
  std::vector<LightGrid> others = steered;
  parallel_blocks(triangles_.size(), block, [&](std::size_t begin, std::size_t end) {
    for (std::size_t t = begin; t < end; ++t) {
      const auto& c = triangles_[t];
      (steered_[t] ? steered : others)[begin / block].add_triangle(landed[c[0]], landed[c[1]], landed[c[2]], flux_[t]);
    }
  });
  // What others bring already is not asked of the steered, nor to take back what others have spilled; what is left of the
  // picture is then as much light as they have.
  Errors errors{wanted_};
  std::vector<double> there(wanted_.values.size(), 0.0);
  double asked = 0, had = 0;
  for (std::size_t i = 0; i < there.size(); ++i) {
    double& missing = errors.missing.values[i];
    for (const LightGrid& part : steered) there[i] += part.flux.values[i];
    for (const LightGrid& part : others) missing -= part.flux.values[i];
    errors.sum += std::abs(missing - there[i]);
    missing = std::max(missing, 0.0);
    if (!judged_[i]) continue;
    asked += missing;
    had += there[i];
  }
  for (std::size_t i = 0; i < there.size(); ++i) {
    double& missing = errors.missing.values[i];
    missing = judged_[i] && asked > 0 ? missing * had / asked - there[i] : 0;
  }
  return errors;
}

std::vector<Vec2> PictureLoop::moves(const Errors& errors, const std::vector<Vec2>& landed_mm) const {
  const std::vector<Vec2> landed = in_pixels(landed_mm);
  std::vector<Vec3> shares(triangles_.size(), Vec3::Zero());
  parallel_blocks(triangles_.size(), 4096, [&](std::size_t begin, std::size_t end) {
    for (std::size_t t = begin; t < end; ++t) {
      const auto& c = triangles_[t];
      if (areas_[t] > 0) shares[t] = weighed(errors.missing, {landed[c[0]], landed[c[1]], landed[c[2]]});
    }
  });
  Eigen::VectorXd right = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(landed.size()));
  for (std::size_t t = 0; t < triangles_.size(); ++t) {
    for (int k = 0; k < 3; ++k) right[triangles_[t][k]] += shares[t][k];
  }
  const OneBlasThread one_blas_thread;
  const Eigen::VectorXd potential = factor_->cholesky.solve(right);
  if (!potential.allFinite()) throw NumericalError("surface: the equations of the picture's errors have no finite solution");

  // A vertex takes the mean of its triangles' gradients.
  std::vector<Vec2> moves(landed.size(), Vec2::Zero());
  std::vector<double> weights(landed.size(), 0.0);
  for (std::size_t t = 0; t < triangles_.size(); ++t) {
    if (!(areas_[t] > 0)) continue;
    const auto& c = triangles_[t];
    Vec2 gradient = Vec2::Zero();
    for (int k = 0; k < 3; ++k) gradient += potential[c[k]] * gradients_[t][k];
    for (int k = 0; k < 3; ++k) {
      moves[c[k]] += areas_[t] * gradient;
      weights[c[k]] += areas_[t];
    }
  }
  // Farther the first order does not reach.
  const double most = extent_.size().maxCoeff() / std::max(wanted_.width, wanted_.height) / 2;
  for (std::size_t v = 0; v < moves.size(); ++v) {
    if (weights[v] > 0) moves[v] /= weights[v];
    moves[v] *= most / std::max(most, moves[v].norm());
  }
  return moves;
}

}  // namespace lightmill::detail
