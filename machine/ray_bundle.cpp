#include "machine/ray_bundle.h"

#include <algorithm>

namespace lightmill {

void RayBundle::subtract(int column, int row, Span cut) {
  Ray& ray = rays_.at(column, row);
  const auto below = [&](const Span& span) { return Span{span.from, std::min(span.to, cut.from)}; };
  const auto above = [&](const Span& span) { return Span{std::max(span.from, cut.to), span.to}; };
  if (cut.empty()) return;
  if (ray.many == 0) {
    if (!ray.only.meets(cut)) return;
    const Span low = below(ray.only), high = above(ray.only);
    if (!low.empty() && !high.empty()) {
      many_[row].push_back({low, high});
      ray.many = static_cast<std::uint32_t>(many_[row].size());
    } else {
      ray.only = low.empty() ? high : low;
    }
    return;
  }
  std::vector<Span>& spans = many_[row][ray.many - 1];
  for (std::size_t k = 0; k < spans.size();) {
    if (!spans[k].meets(cut)) {
      ++k;
      continue;
    }
    const Span low = below(spans[k]), high = above(spans[k]);
    const auto place = spans.erase(spans.begin() + static_cast<std::ptrdiff_t>(k));
    const std::size_t left = static_cast<std::size_t>(!low.empty()) + static_cast<std::size_t>(!high.empty());
    if (left == 2) {
      spans.insert(place, {low, high});
    } else if (left == 1) {
      spans.insert(place, low.empty() ? high : low);
    }
    k += left;
  }
}

void RayBundle::set(int column, int row, std::span<const Span> spans) {
  Ray& ray = rays_.at(column, row);
  ray.only = spans.empty() ? Span{} : spans.front();
  ray.many = 0;
  if (spans.size() < 2) return;
  many_[row].emplace_back(spans.begin(), spans.end());
  ray.many = static_cast<std::uint32_t>(many_[row].size());
}

double RayBundle::length_mm() const {
  double length = 0;
  for (int row = 0; row < rows(); ++row) {
    for (int column = 0; column < columns(); ++column) {
      for (const Span& span : at(column, row)) length += static_cast<double>(span.to) - span.from;
    }
  }
  return length;
}

std::size_t RayBundle::bytes() const {
  std::size_t bytes = rays_.values.capacity() * sizeof(Ray);
  for (const auto& row : many_) {
    bytes += row.capacity() * sizeof(row.front());
    for (const auto& spans : row) bytes += spans.capacity() * sizeof(Span);
  }
  return bytes;
}

}  // namespace lightmill
