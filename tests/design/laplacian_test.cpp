// Graph Laplacians: solutions satisfy their equations, with and without hubs, in one piece and in halves.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <random>

#include "design/core/parallel.h"
#include "design/detail/laplacian.h"

namespace lightmill::detail {
namespace {

/// A triangulated grid of `side` x `side` nodes off their places, and hubs that a third of them lead to.
struct Graph {
  Graph(int side, int hubs) {
    std::mt19937 random(3);
    std::uniform_real_distribution<double> weight(0.5, 1.5), off(-0.3, 0.3);
    for (int y = 0; y < side; ++y) {
      for (int x = 0; x < side; ++x) {
        const int i = y * side + x;
        nodes.emplace_back(x + off(random), y + off(random));
        if (x > 0) edges.push_back({i - 1, i, weight(random)});
        if (y > 0) edges.push_back({i, i - side, weight(random)});
        if (x > 0 && y > 0) edges.push_back({i, i - side - 1, weight(random)});
      }
    }
    const int n = side * side;
    for (int hub = 0; hub < hubs; ++hub) {
      for (int k = 0; k < n / 3; ++k) edges.push_back({static_cast<int>(random() % n), n + hub, weight(random)});
    }
    for (int i = 0; i < n; ++i) rhs.push_back(off(random));
    const double mean = std::accumulate(rhs.begin(), rhs.end(), 0.0) / n;
    for (double& b : rhs) b -= mean;
  }
  std::vector<Vec2> nodes;
  std::vector<GraphEdge> edges;
  std::vector<double> rhs;
};

class LaplacianOf : public ::testing::TestWithParam<std::pair<int, int>> {};

TEST_P(LaplacianOf, SolutionsSatisfyTheirEquations) {
  const auto [side, hubs] = GetParam();
  const Graph graph(side, hubs);
  const std::vector<double> x = Laplacian(graph.nodes, graph.edges, hubs).solve(graph.rhs);
  ASSERT_EQ(x.size(), graph.nodes.size());
  EXPECT_NEAR(std::accumulate(x.begin(), x.end(), 0.0), 0, 1e-9 * static_cast<double>(x.size()));
  // A hub's own equation: it has the weighted mean of its neighbours.
  std::vector<double> all = x;
  std::vector<double> sum(hubs, 0), weight(hubs, 0);
  for (const auto& edge : graph.edges) {
    if (edge.b < static_cast<int>(x.size())) continue;
    sum[edge.b - x.size()] += edge.weight * x[edge.a];
    weight[edge.b - x.size()] += edge.weight;
  }
  for (int hub = 0; hub < hubs; ++hub) all.push_back(sum[hub] / weight[hub]);
  std::vector<double> left(all.size(), 0);
  for (const auto& edge : graph.edges) {
    const double flow = edge.weight * (all[edge.a] - all[edge.b]);
    left[edge.a] += flow;
    left[edge.b] -= flow;
  }
  for (std::size_t i = 0; i < x.size(); ++i) ASSERT_NEAR(left[i], graph.rhs[i], 1e-10) << i;
}

// Small graphs are factorised whole, from 4,096 nodes on in halves.
INSTANTIATE_TEST_SUITE_P(Graphs, LaplacianOf,
                         ::testing::Values(std::pair(2, 0), std::pair(20, 0), std::pair(20, 3), std::pair(63, 0),
                                           std::pair(64, 0), std::pair(90, 0), std::pair(90, 1), std::pair(90, 4)));

TEST(Laplacian, ThreadsDoNotChangeABit) {
  const Graph graph(90, 1);
  const std::vector<double> two = Laplacian(graph.nodes, graph.edges, 1).solve(graph.rhs);
  set_thread_count(1);
  const std::vector<double> one = Laplacian(graph.nodes, graph.edges, 1).solve(graph.rhs);
  set_thread_count(0);
  EXPECT_EQ(one, two);
}

TEST(Laplacian, AGraphInTwoPartsIsRefused) {
  const std::vector<Vec2> nodes = {{0, 0}, {1, 0}, {5, 0}, {6, 0}};
  EXPECT_THROW(Laplacian(nodes, {{0, 1, 1.0}, {2, 3, 1.0}}), std::exception);
}

TEST(Laplacian, TiedPartsAreSolvedEachByItself) {
  const std::vector<Vec2> nodes = {{0, 0}, {1, 0}, {5, 0}, {6, 0}, {9, 9}};
  for (const double tie : {1e-3, 1.0, 1e3}) {
    std::vector<GraphEdge> edges = {{0, 1, 1.0}, {2, 3, 2.0}};
    tie_parts(5, tie, edges);
    EXPECT_EQ(edges.size(), 4);
    const std::vector<double> x = Laplacian(nodes, edges).solve({1, -1, 3, -3, 0});
    EXPECT_NEAR(x[0] - x[1], 1, 1e-12);
    EXPECT_NEAR(x[2] - x[3], 1.5, 1e-12);
    EXPECT_NEAR(x[0], x[2], 1e-12);
    EXPECT_NEAR(x[0], x[4], 1e-12);
  }
}

TEST(Laplacian, TheSquareOfOneIsOneTooWithWeightsBelowZero) {
  const Graph graph(70, 0);
  const int n = static_cast<int>(graph.nodes.size());
  std::vector<std::map<int, double>> rows(n);
  for (const auto& [a, b, weight] : graph.edges) {
    rows[a][a] += weight;
    rows[b][b] += weight;
    rows[a][b] -= weight;
    rows[b][a] -= weight;
  }
  std::vector<GraphEdge> square;
  for (int k = 0; k < n; ++k) {
    for (const auto& [a, x] : rows[k]) {
      for (const auto& [b, y] : rows[k]) {
        if (a < b) square.push_back({a, b, -x * y});
      }
    }
  }
  EXPECT_TRUE(std::any_of(square.begin(), square.end(), [](const GraphEdge& edge) { return edge.weight < 0; }));
  const Laplacian once(graph.nodes, graph.edges);
  const std::vector<double> wanted = once.solve(once.solve(graph.rhs));
  const std::vector<double> x = Laplacian(graph.nodes, square, 0, 2).solve(graph.rhs);
  const double scale = std::abs(*std::max_element(wanted.begin(), wanted.end()));
  for (int i = 0; i < n; ++i) ASSERT_NEAR(x[i], wanted[i], 1e-7 * scale) << i;
}

}  // namespace
}  // namespace lightmill::detail
