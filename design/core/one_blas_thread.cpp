#include "design/core/one_blas_thread.h"

#include <dlfcn.h>

namespace lightmill {

namespace {

template <typename Function>
Function* found(const char* name) {
  return reinterpret_cast<Function*>(dlsym(RTLD_DEFAULT, name));
}

}  // namespace

OneBlasThread::OneBlasThread() {
  // Looked up, because another BLAS may stand behind CHOLMOD, and CHOLMOD may be built without OpenMP.
  auto* const blas_threads = found<int()>("openblas_get_num_threads");
  set_blas_threads_ = found<void(int)>("openblas_set_num_threads");
  if (blas_threads && set_blas_threads_) {
    blas_threads_ = blas_threads();
    set_blas_threads_(1);
  }
  auto* const levels = found<int()>("omp_get_max_active_levels");
  set_levels_ = found<void(int)>("omp_set_max_active_levels");
  if (levels && set_levels_) {
    levels_ = levels();
    set_levels_(0);
  }
}

OneBlasThread::~OneBlasThread() {
  if (blas_threads_ >= 0) set_blas_threads_(blas_threads_);
  if (levels_ >= 0) set_levels_(levels_);
}

}  // namespace lightmill
