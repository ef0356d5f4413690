// Runs a fuzz target where the compiler has no libFuzzer: seeded mutations of its seeds for so many seconds.
//   TARGET_fuzz SECONDS SEEDS DICTIONARY FOUND   the input that crashes or hangs is left in the file FOUND
//   TARGET_fuzz FILE                             once more
#include <fcntl.h>
#include <sanitizer/common_interface_defs.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <iterator>
#include <random>
#include <string>
#include <vector>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace {

constexpr std::size_t kLongest = 4000;
constexpr unsigned kHang_s = 30;
std::string input;
const char* found = nullptr;

void keep_input() {
  if (found == nullptr) return;
  const int file = open(found, O_CREAT | O_WRONLY | O_TRUNC, 0644);
  [[maybe_unused]] const auto written = write(file, input.data(), input.size());
  close(file);
  constexpr char kSaid[] = "\nthe input is kept\n";
  [[maybe_unused]] const auto said = write(2, kSaid, sizeof kSaid - 1);
}

void end_by_signal(int) {
  keep_input();
  _exit(1);
}

std::string file_text(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

/// A line each, in double quotes, as libFuzzer reads them.
std::vector<std::string> dictionary(const std::filesystem::path& path) {
  std::vector<std::string> words;
  std::ifstream file(path);
  for (std::string line; std::getline(file, line);) {
    if (line.size() > 2 && line.front() == '"') words.push_back(line.substr(1, line.size() - 2));
  }
  return words;
}

class Mutations {
 public:
  Mutations(std::vector<std::string> seeds, std::vector<std::string> words) : seeds_(std::move(seeds)), words_(std::move(words)) {}

  std::string next() {
    std::string text = any(seeds_);
    for (std::size_t n = 1 + below(8); n > 0; --n) mutate(text);
    text.resize(std::min(text.size(), kLongest));
    return text;
  }

 private:
  std::vector<std::string> seeds_, words_;
  std::mt19937 random_{2014};

  std::size_t below(std::size_t most) { return random_() % most; }
  const std::string& any(const std::vector<std::string>& from) { return from[below(from.size())]; }

  void mutate(std::string& text) {
    if (text.empty()) text = any(seeds_);
    const std::size_t at = below(text.size());
    switch (below(7)) {
      case 0:
        text[at] = static_cast<char>(random_());
        break;
      case 1:
        text.erase(at, 1 + below(12));
        break;
      case 2:
        text.insert(at, any(words_));
        break;
      case 3:
        text.insert(at, 1, "0123456789.-+\n #?!~\x18"[below(20)]);
        break;
      case 4: {
        const std::string& other = any(seeds_);
        text.insert(at, other, below(other.size()), below(80));
        break;
      }
      case 5:
        text.insert(at, text, below(text.size()), below(80));
        break;
      default:
        text.insert(at, below(300), text[at]);
    }
  }
};

}  // namespace

int main(int count, char** arguments) {
  if (count == 2) {
    input = file_text(arguments[1]);
    return LLVMFuzzerTestOneInput(reinterpret_cast<const std::uint8_t*>(input.data()), input.size());
  }
  if (count != 5) {
    std::cerr << arguments[0] << ": SECONDS SEEDS DICTIONARY FOUND, or FILE\n";
    return 2;
  }
  std::vector<std::filesystem::path> paths;
  for (const auto& entry : std::filesystem::directory_iterator(arguments[2])) paths.push_back(entry.path());
  std::sort(paths.begin(), paths.end());
  std::vector<std::string> seeds;
  for (const auto& path : paths) seeds.push_back(file_text(path));
  Mutations mutations(std::move(seeds), dictionary(arguments[3]));
  found = arguments[4];
  __sanitizer_set_death_callback(keep_input);
  std::signal(SIGABRT, end_by_signal);
  std::signal(SIGALRM, end_by_signal);

  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(std::atol(arguments[1]));
  long inputs = 0;
  for (; std::chrono::steady_clock::now() < end; ++inputs) {
    input = mutations.next();
    alarm(kHang_s);
    LLVMFuzzerTestOneInput(reinterpret_cast<const std::uint8_t*>(input.data()), input.size());
  }
  alarm(0);
  std::cout << arguments[0] << ": " << inputs << " inputs\n";
  return 0;
}
