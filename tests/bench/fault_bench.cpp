// A hundred places (or as many as asked for) for every fault of line, control and sender: what the sender says, and what a
// resume leaves. Writes the tables of machine/README.md, unless other places are asked for: fault_bench PLACES [SEED]
#include <cstdio>
#include <cstdlib>
#include <fstream>

#include "design/core/files.h"
#include "tests/machine/fault_matrix.h"
#include "tests/machine/resume_matrix.h"

namespace {

using namespace lightmill;
using namespace lightmill::test;

bool good = true;
unsigned other_places = 0;

template <typename Row>
Row checked(Row row) {
  for (const std::string& broken : row.broken) std::fprintf(stderr, "BROKEN %s\n", broken.c_str());
  good = good && row.broken.empty();
  return row;
}

void write_table(const std::string& begin, const std::string& end, const std::string& table) {
  std::fputs(table.c_str(), stdout);
  if (other_places != 0) return;
  const std::string path = LIGHTMILL_SOURCE_DIR "/machine/README.md";
  std::string readme = read_whole(path);
  const std::size_t open = readme.find(begin), close = readme.find(end);
  if (open == std::string::npos || close == std::string::npos) return;
  write_whole(path, readme.replace(open, close + end.size() - open, table));
}

}  // namespace

int main(int argc, char** argv) {
  const int places = argc > 1 ? std::atoi(argv[1]) : 100;
  other_places = argc > 2 ? static_cast<unsigned>(std::atoi(argv[2])) : 0;
  std::vector<MatrixRow> hal, grbl;
  unsigned seed = 1 + 1000 * other_places;
  for (const MatrixFault& fault : matrix_faults()) {
    hal.push_back(checked(matrix_row(fault, Personality::kGrblHal, places, seed)));
    grbl.push_back(checked(matrix_row(fault, Personality::kGrbl, places, seed++)));
  }
  write_table(kFaultTable, kFaultTableEnd, markdown(hal, grbl));
  const ResumeCase program = resume_case();
  std::vector<ResumeRow> rows;
  for (const ResumeFault& fault : resume_faults()) rows.push_back(checked(resume_row(program, fault, places, 20240611 + other_places)));
  write_table(kResumeTable, kResumeTableEnd, markdown(rows));
  return good ? 0 : 1;
}
