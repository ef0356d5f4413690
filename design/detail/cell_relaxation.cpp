#include "design/detail/cell_relaxation.h"

#include <algorithm>
#include <cmath>
#include <deque>
#include <unordered_map>

namespace lightmill::detail {

namespace {

constexpr int kMostTries = 40;
constexpr std::size_t kMostNeighbours = 24;  // of a cell that is grown, or looked at again: others are left to whole steps
constexpr double kFirstFall = 0.05;  // of a potential, in distances to a neighbour times that one's perimeter

/// A power diagram whose potentials have changed here and there.
class AgedDiagram {
 public:
  AgedDiagram(const PowerDiagram& built, const std::vector<Vec2>& its_sites, std::vector<double> potentials)
      : diagram(built), sites(its_sites), psi(std::move(potentials)) {
    for (const auto& hidden : built.hidden) near_[hidden.site] = hidden.near;
  }

  const PowerDiagram& diagram;
  const std::vector<Vec2>& sites;
  std::vector<double> psi;

  /// A site that has, or had, a cell and is near.
  [[nodiscard]] int near(int site) const {
    const auto found = near_.find(site);
    if (found != near_.end()) return found->second;
    for (std::size_t k = diagram.first_edge[site]; k < diagram.first_edge[site + 1]; ++k) {
      const int other = across(diagram.incident_edges[k], site);
      if (other < static_cast<int>(sites.size())) return other;
    }
    return -1;
  }
  /// Calls visit(other) for neighbours in the diagram and for those that have appeared beside the site since.
  template <typename Visit>
  void for_each_neighbour(int site, const Visit& visit) const {
    for (std::size_t k = diagram.first_edge[site]; k < diagram.first_edge[site + 1]; ++k) {
      const int other = across(diagram.incident_edges[k], site);
      if (other < static_cast<int>(sites.size())) visit(other);
    }
    const auto guests = guests_.find(site);
    if (guests == guests_.end()) return;
    for (const int guest : guests->second) visit(guest);
  }
  [[nodiscard]] std::size_t degree(int site) const { return diagram.first_edge[site + 1] - diagram.first_edge[site]; }
  /// Remembers that `site` touches these cells now.
  void appear(int site, const std::vector<int>& beside) {
    for (const int other : beside) {
      meet(other, site);
      meet(site, other);
    }
  }
  [[nodiscard]] double perimeter(int site) const {
    double sum = 0;
    for (std::size_t k = diagram.first_edge[site]; k < diagram.first_edge[site + 1]; ++k) {
      const DualEdge& edge = diagram.edges[diagram.incident_edges[k]];
      sum += (diagram.vertices[edge.to] - diagram.vertices[edge.from]).norm();
    }
    return sum;
  }

 private:
  [[nodiscard]] int across(int e, int site) const {
    return diagram.edges[e].a == site ? diagram.edges[e].b : diagram.edges[e].a;
  }
  void meet(int site, int guest) {
    auto& guests = guests_[site];
    if (std::find(guests.begin(), guests.end(), guest) == guests.end()) guests.push_back(guest);
  }

  std::unordered_map<int, int> near_;  // of sites without a cell
  std::unordered_map<int, std::vector<int>> guests_;
};

/// The cell that one site would have at any potential among the others as they are.
class GrownCell {
 public:
  /// `beside`: another site that is near.
  GrownCell(const AgedDiagram& aged, int site, int beside, double reach) : aged_(aged), site_(site), reach_(reach) {
    const auto meet = [this](int other) {
      if (other != site_ && !is_rival(other)) rivals_.push_back(other);
    };
    for (const int centre : {beside, site, aged.near(site)}) {
      if (centre < 0) continue;
      meet(centre);
      // Those of a cell that has very many are found one by one, as they are needed.
      if (aged.degree(centre) <= kMostNeighbours) aged.for_each_neighbour(centre, meet);
    }
  }

  /// Counter-clockwise; empty when there is none. Half planes of rivals cut it from a square: of those who are near, and of
  /// whoever holds a corner that is left, until the site beats all others at every corner.
  const std::vector<Vec2>& at(double potential) {
    potential_ = potential;
    corners_ = {{-reach_, -reach_}, {reach_, -reach_}, {reach_, reach_}, {-reach_, reach_}};
    won_.assign(4, 0);
    across_.assign(4, -1);
    for (const int rival : rivals_) cut(rival);
    for (std::size_t k = 0; k < corners_.size();) {
      if (won_[k]) {
        ++k;
        continue;
      }
      const Vec2& x = corners_[k];
      const int hint = across_[k] >= 0 && has_cell(across_[k]) ? across_[k] : rivals_.front();
      const int owner = cell_at(aged_.diagram, aged_.sites, aged_.psi, x, hint);
      const Vec2& s = aged_.sites[site_];
      const double lead = x.dot(s - aged_.sites[owner]) - (potential_ - aged_.psi[owner]);
      const double rounding = 1e-13 * (x.norm() * s.norm() + std::abs(potential_));
      if (owner == site_ || lead >= -rounding || is_rival(owner)) {
        won_[k++] = 1;
        continue;
      }
      rivals_.push_back(owner);
      cut(owner);
      k = 0;
    }
    if (corners_.size() < 3) corners_.clear();
    return corners_;
  }
  /// The sites across its borders.
  [[nodiscard]] std::vector<int> neighbours() const {
    std::vector<int> found;
    for (const int site : across_) {
      if (site >= 0) found.push_back(site);
    }
    return found;
  }

 private:
  [[nodiscard]] bool is_rival(int site) const {
    return std::find(rivals_.begin(), rivals_.end(), site) != rivals_.end();
  }
  [[nodiscard]] bool has_cell(int site) const {
    return aged_.degree(site) > 0;
  }

  void cut(int rival) {
    const Vec2 normal = aged_.sites[site_] - aged_.sites[rival];
    const double offset = potential_ - aged_.psi[rival];
    const std::size_t count = corners_.size();
    lead_.resize(count);
    bool all = true;
    for (std::size_t k = 0; k < count; ++k) {
      lead_[k] = normal.dot(corners_[k]) - offset;
      all &= lead_[k] >= 0;
    }
    if (all) return;
    cut_corners_.clear();
    cut_won_.clear();
    cut_across_.clear();
    for (std::size_t k = 0; k < count; ++k) {
      const std::size_t next = k + 1 == count ? 0 : k + 1;
      if (lead_[k] >= 0) {
        cut_corners_.push_back(corners_[k]);
        cut_won_.push_back(won_[k]);
        cut_across_.push_back(lead_[next] >= 0 || lead_[k] > 0 ? across_[k] : rival);
      }
      if ((lead_[k] > 0 && lead_[next] < 0) || (lead_[k] < 0 && lead_[next] > 0)) {
        cut_corners_.push_back(corners_[k] + lead_[k] / (lead_[k] - lead_[next]) * (corners_[next] - corners_[k]));
        cut_won_.push_back(0);
        cut_across_.push_back(lead_[k] > 0 ? rival : across_[k]);
      }
    }
    corners_.swap(cut_corners_);
    won_.swap(cut_won_);
    across_.swap(cut_across_);
  }

  const AgedDiagram& aged_;
  int site_;
  double reach_;
  double potential_ = 0;
  std::vector<int> rivals_;
  std::vector<Vec2> corners_, cut_corners_;
  std::vector<double> lead_;
  std::vector<char> won_, cut_won_;       // per corner: no other cell beats the site there
  std::vector<int> across_, cut_across_;  // per corner: the rival across the side that begins there, -1 at the square
};

/// Searches the potential that gives a cell a share within the options' bounds; false when none is found. At `enough` a
/// point of light alone would do.
bool grow(const PolygonMeasure& light, const PointPull& pull, const AgedDiagram& aged, GrownCell& cell, int site, int near,
          double share, double wanted, double enough, const RelaxationOptions& options, double& potential) {
  double fall = kFirstFall * std::min(aged.perimeter(near), options.reach) * (aged.sites[site] - aged.sites[near]).norm();
  if (!(fall > 0)) fall = 1e-6 * wanted * options.reach * options.reach;
  fall = std::clamp(potential - enough, 0.0, fall);
  double too_little = 0;
  double too_much = 0;
  double share_little = std::max(share, 0.0);
  double share_much = 0;
  const double aim = (options.least + options.most) / 2;
  for (int attempt = 0; attempt < kMostTries; ++attempt) {
    const double tried = potential - fall;
    const double now = (light.mass(cell.at(tried)) + pull.mass(site, aged.psi[site], tried)) / wanted;
    if (now >= options.least && now <= options.most) {
      potential -= fall;
      return true;
    }
    if (now < options.least) {
      too_little = fall;
      share_little = std::max(now, 0.0);
    } else {
      too_much = fall;
      share_much = now;
    }
    // A cell grows with the square of the fall at first.
    if (too_much == 0) {
      fall *= now > 0 ? std::clamp(std::sqrt(aim / now), 1.5, 8.0) : 4.0;
      if (enough < tried) fall = std::min(fall, potential - enough);
    } else {
      const double low = std::sqrt(share_little);
      const double part = (std::sqrt(aim) - low) / (std::sqrt(share_much) - low);
      fall = too_little + std::clamp(part, 0.1, 0.9) * (too_much - too_little);
    }
  }
  return false;
}

}  // namespace

std::vector<double> relax_cells(const TargetMeasure& measure, const PowerDiagram& diagram, const std::vector<Vec2>& sites,
                                const std::vector<double>& psi, const std::vector<double>& masses,
                                const std::vector<double>& wanted, const RelaxationOptions& options) {
  const int n = static_cast<int>(sites.size());
  std::deque<int> queue;
  std::vector<char> queued(n, 0);
  std::vector<double> shares(n);
  for (int i = 0; i < n; ++i) {
    shares[i] = masses[i] / wanted[i];
    if (shares[i] >= options.below) continue;
    queue.push_back(i);
    queued[i] = 1;
  }
  if (queue.empty()) return psi;

  const PolygonMeasure light(measure);
  PointPull pull(measure, sites, psi);
  AgedDiagram aged(diagram, sites, psi);
  // A hidden site appears at the dual vertex of the triangle that it lies under.
  std::unordered_map<int, double> appearance;
  for (const auto& hidden : diagram.hidden) {
    const Vec2& x = diagram.vertices[hidden.vertex];
    appearance[hidden.site] = x.dot(sites[hidden.site] - sites[hidden.near]) + psi[hidden.near];
  }
  std::size_t moves = 0;
  const std::size_t most_moves = options.moves_per_cell * queue.size();
  while (!queue.empty() && moves < most_moves) {
    const int site = queue.front();
    queue.pop_front();
    queued[site] = 0;
    const int near = aged.near(site);
    double potential = aged.psi[site];
    const double enough = pull.potential_for(site, potential, (options.least + options.most) / 2 * wanted[site]);
    const auto appears = appearance.find(site);
    if (appears != appearance.end() && enough > appears->second) {
      pull.move(site, aged.psi[site], enough);
      aged.psi[site] = enough;
      continue;
    }
    if (near < 0 || aged.degree(site) > kMostNeighbours) continue;
    GrownCell cell(aged, site, near, options.reach);
    if (appears != appearance.end()) potential = std::min(potential, appears->second);
    if (!grow(light, pull, aged, cell, site, near, shares[site], wanted[site], enough, options, potential)) continue;
    pull.move(site, aged.psi[site], potential);
    aged.psi[site] = potential;
    shares[site] = options.least;
    ++moves;
    const std::vector<int> neighbours = cell.neighbours();
    aged.appear(site, neighbours);
    for (const int other : neighbours) {
      if (queued[other] || aged.degree(other) > kMostNeighbours) continue;
      GrownCell rest(aged, other, site, options.reach);
      const double psi_other = aged.psi[other];
      shares[other] = (light.mass(rest.at(psi_other)) + pull.mass(other, psi_other, psi_other)) / wanted[other];
      if (shares[other] >= options.below) continue;
      queue.push_back(other);
      queued[other] = 1;
    }
  }
  return std::move(aged.psi);
}

}  // namespace lightmill::detail
