// A hundred places for every way in which a stream can end early: is the place found true, and what does the resume
// leave? Writes the table of machine/README.md.
#include <cstdio>
#include <cstdlib>

#include "tests/machine/resume_matrix.h"

int main(int argc, char** argv) {
  using namespace lightmill::test;
  const int places = argc > 1 ? std::atoi(argv[1]) : 100;
  const ResumeCase program = resume_case();
  std::vector<ResumeRow> rows;
  bool good = true;
  for (const ResumeFault& fault : resume_faults()) {
    rows.push_back(resume_row(program, fault, places, 20240611));
    for (const std::string& broken : rows.back().broken) std::fprintf(stderr, "BROKEN %s\n", broken.c_str());
    good = good && rows.back().broken.empty();
  }
  std::fputs(markdown(rows).c_str(), stdout);
  return good ? 0 : 1;
}
