// Tables of float64 in NumPy's file format, version 1.0.
#pragma once

#include <filesystem>
#include <vector>

namespace lightmill {

/// Row-major `rows` x `columns`.
struct NpyTable {
  int columns = 0;
  std::vector<double> values;
  [[nodiscard]] std::size_t rows() const { return columns > 0 ? values.size() / columns : 0; }
};

/// Written whole or not at all.
void write_npy(const std::filesystem::path& path, const NpyTable& table);
/// Throws InputError unless the file is a C-ordered little-endian float64 table of two dimensions.
NpyTable read_npy(const std::filesystem::path& path);

}  // namespace lightmill
