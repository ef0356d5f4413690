#include "design/detail/one_blas_thread.h"

#include <dlfcn.h>

namespace lightmill::detail {

OneBlasThread::OneBlasThread() {
  // Looked up, because another BLAS may stand behind CHOLMOD.
  const auto get = reinterpret_cast<int (*)()>(dlsym(RTLD_DEFAULT, "openblas_get_num_threads"));
  set_ = reinterpret_cast<void (*)(int)>(dlsym(RTLD_DEFAULT, "openblas_set_num_threads"));
  if (!get || !set_) return;
  before_ = get();
  set_(1);
}

OneBlasThread::~OneBlasThread() {
  if (before_ > 0) set_(before_);
}

}  // namespace lightmill::detail
