#include "fault_matrix.h"

#include <gtest/gtest.h>

#include <cstdio>
#include <cstdlib>

namespace lightmill {
namespace {

/// With LIGHTMILL_MATRIX=100 so many places each; the table goes to stdout, for the room's README.
int places() {
  const char* asked = std::getenv("LIGHTMILL_MATRIX");
  return asked != nullptr ? std::atoi(asked) : 12;
}

class FaultMatrix : public testing::TestWithParam<Personality> {};

TEST_P(FaultMatrix, NothingIsLostOrRepeatedWithoutBeingSaid) {
  std::vector<test::MatrixRow> rows;
  unsigned seed = 1;
  for (const test::MatrixFault& fault : test::matrix_faults()) {
    rows.push_back(test::matrix_row(fault, GetParam(), places(), seed++));
    for (const std::string& broken : rows.back().broken) ADD_FAILURE() << broken;
  }
  if (places() > 12) std::printf("%s", test::markdown(rows).c_str());
}

INSTANTIATE_TEST_SUITE_P(Controllers, FaultMatrix, testing::Values(Personality::kGrblHal, Personality::kGrbl),
                         [](const auto& instance) { return instance.param == Personality::kGrbl ? "grbl" : "grblHAL"; });

}  // namespace
}  // namespace lightmill
