#include "fault_matrix.h"

#include <gtest/gtest.h>

#include "design/core/files.h"

namespace lightmill {
namespace {

class FaultMatrix : public testing::TestWithParam<Personality> {};

// Few places here; fault_bench makes a hundred and writes the README's table.
TEST_P(FaultMatrix, NothingIsLostOrRepeatedWithoutBeingSaid) {
  unsigned seed = 1;
  for (const test::MatrixFault& fault : test::matrix_faults()) {
    const test::MatrixRow row = test::matrix_row(fault, GetParam(), 12, seed++);
    for (const std::string& broken : row.broken) ADD_FAILURE() << broken;
    EXPECT_EQ(row.went_on + row.doubtful + row.stopped + row.silent, row.places) << fault.name;
  }
}

INSTANTIATE_TEST_SUITE_P(Controllers, FaultMatrix, testing::Values(Personality::kGrblHal, Personality::kGrbl),
                         [](const auto& instance) { return instance.param == Personality::kGrbl ? "grbl" : "grblHAL"; });

TEST(FaultMatrixTable, HasEveryFault) {
  const std::string readme = read_whole(std::string(LIGHTMILL_SOURCE_DIR) + "/machine/README.md");
  const std::size_t from = readme.find(test::kFaultTable);
  ASSERT_NE(from, std::string::npos);
  const std::string table = readme.substr(from, readme.find(test::kFaultTableEnd) - from);
  for (const test::MatrixFault& fault : test::matrix_faults()) EXPECT_NE(table.find("| " + fault.name + " | 100 |"), std::string::npos) << fault.name;
}

}  // namespace
}  // namespace lightmill
