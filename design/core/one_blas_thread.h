// Serial BLAS and OpenMP inside a scope.
#pragma once

namespace lightmill {

/// OpenBLAS's threads and those of CHOLMOD's OpenMP loops wait for each other by spinning: on a machine that has other work
/// they burn more than they give (measured: 56 against 28 CPU seconds for the one, a factorisation of 0.33 against 0.5 for
/// the other). The blocks of these factors are small; one thread is nearly as fast on an idle machine, and its sums do not
/// depend on the number of threads.
class OneBlasThread {
 public:
  OneBlasThread();
  ~OneBlasThread();
  OneBlasThread(const OneBlasThread&) = delete;
  OneBlasThread& operator=(const OneBlasThread&) = delete;

 private:
  void (*set_blas_threads_)(int) = nullptr;
  void (*set_levels_)(int) = nullptr;
  int blas_threads_ = -1;  // before; -1: left alone
  int levels_ = -1;
};

}  // namespace lightmill
