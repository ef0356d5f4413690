// Fuzzes what else is read from files; the first byte says which kind of file it is to be.
#include <cstdlib>
#include <filesystem>
#include <fstream>

#include <unistd.h>

#include "cam/cutter.h"
#include "cli/job.h"
#include "cli/npy.h"
#include "design/core/errors.h"
#include "design/mesh.h"
#include "postproc/machine_model.h"

namespace {

using namespace lightmill;

/// A file of this process alone, in memory where there is such a folder.
std::filesystem::path written(const std::string& extension, std::string_view content) {
  static const std::filesystem::path folder =
      std::filesystem::exists("/dev/shm") ? "/dev/shm" : std::filesystem::temp_directory_path();
  const std::filesystem::path path = folder / ("lightmill_fuzz_" + std::to_string(getpid()) + extension);
  std::ofstream(path, std::ios::binary | std::ios::trunc).write(content.data(), static_cast<std::streamsize>(content.size()));
  return path;
}

void require_sound(const SurfaceMesh& mesh) {
  for (const auto& triangle : mesh.triangles) {
    for (const int corner : triangle) {
      if (corner < 0 || static_cast<std::size_t>(corner) >= mesh.vertices.size()) std::abort();
    }
  }
  if (mesh.normals.size() != mesh.vertices.size()) std::abort();
}

void read_as(char kind, std::string_view content) {
  switch (kind) {
    case 'j': {
      const std::string resolved = resolved_toml(read_job_text(content, "fuzz.toml", "fixtures/jobs"));
      try {
        read_job_text(resolved, "resolved.toml", "fixtures/jobs");
      } catch (const InputError&) {
        std::abort();  // what was accepted once is accepted again
      }
      return;
    }
    case 'c':
      read_cutter(written(".toml", content));
      return;
    case 'm':
      read_machine(written(".toml", content));
      return;
    case 'p':
      return require_sound(read_surface(written(".ply", content)));
    case 'o':
      return require_sound(read_surface(written(".obj", content)));
    case 's':
      return require_sound(read_surface(written(".stl", content)));
    case 'i':
      return require_sound(read_intensity_ply(written(".ply", content)).mesh);
    case 'n':
      read_npy(written(".npy", content));
      return;
    default:
      return;
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  try {
    read_as(static_cast<char>(data[0]), {reinterpret_cast<const char*>(data) + 1, size - 1});
  } catch (const InputError&) {
  }
  return 0;
}
