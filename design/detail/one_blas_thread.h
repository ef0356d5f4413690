// Serial BLAS inside a scope.
#pragma once

namespace lightmill::detail {

/// OpenBLAS's threads wait for each other by spinning: on a machine that has other work they burn more than they give
/// (measured: 56 against 28 CPU seconds). The blocks of these factors are small; one thread is nearly as fast on an
/// idle one, and its sums do not depend on the number of threads.
class OneBlasThread {
 public:
  OneBlasThread();
  ~OneBlasThread();
  OneBlasThread(const OneBlasThread&) = delete;
  OneBlasThread& operator=(const OneBlasThread&) = delete;

 private:
  void (*set_)(int) = nullptr;
  int before_ = 0;
};

}  // namespace lightmill::detail
