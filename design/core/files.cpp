#include "design/core/files.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <fstream>
#include <sstream>

#include "design/core/errors.h"

namespace lightmill {

namespace fs = std::filesystem;

namespace {

void sync_to_disk(const fs::path& path) {
  const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) throw IoError("cannot reopen " + path.string() + " to sync it: " + std::strerror(errno));
  const int result = ::fsync(fd);
  const int error = errno;
  ::close(fd);
  if (result != 0 && error != EINVAL) throw IoError("cannot sync " + path.string() + ": " + std::strerror(error));
}

}  // namespace

fs::path temporary_beside(const fs::path& path) {
  return path.parent_path() / ("." + path.stem().string() + ".partial" + path.extension().string());
}

void write_whole(const fs::path& path, const std::function<void(const fs::path&)>& write) {
  std::error_code error;
  if (path.has_parent_path()) fs::create_directories(path.parent_path(), error);
  if (error) throw IoError("cannot create folder " + path.parent_path().string() + ": " + error.message());
  const fs::path partial = temporary_beside(path);
  try {
    write(partial);
    sync_to_disk(partial);
  } catch (...) {
    fs::remove(partial, error);
    throw;
  }
  fs::rename(partial, path, error);
  if (error) throw IoError("cannot rename " + partial.string() + " to " + path.string() + ": " + error.message());
}

void write_whole(const fs::path& path, std::string_view content) {
  write_whole(path, [&](const fs::path& partial) {
    std::ofstream out(partial, std::ios::binary);
    out.write(content.data(), static_cast<std::streamsize>(content.size()));
    out.close();
    if (!out) throw IoError("cannot write " + path.string() + ": " + std::strerror(errno));
  });
}

std::string read_whole(const fs::path& path) {
  std::error_code error;
  if (fs::is_directory(path, error)) throw InputError(path.string() + " is a folder; name a file");
  std::ifstream in(path, std::ios::binary);
  if (!in) throw InputError("cannot read " + path.string() + ": " + std::strerror(errno) + "; check the path");
  std::ostringstream content;
  content << in.rdbuf();
  return std::move(content).str();
}

}  // namespace lightmill
