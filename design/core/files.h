// Files that are whole or absent: written beside their place, synced, then renamed.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <string_view>

namespace lightmill {

/// The path a writer uses until the file is whole: beside `path`, with the same extension (writers choose formats by it).
std::filesystem::path temporary_beside(const std::filesystem::path& path);

/// Calls write(temporary path), syncs the result to disk and renames it to `path`; on any exception removes the temporary
/// file and rethrows. Throws IoError when the system refuses. Parent folders are created.
void write_whole(const std::filesystem::path& path, const std::function<void(const std::filesystem::path&)>& write);

/// write_whole() for text or bytes at hand.
void write_whole(const std::filesystem::path& path, std::string_view content);

/// The whole file. Throws InputError that names the path when it cannot be read.
std::string read_whole(const std::filesystem::path& path);

}  // namespace lightmill
