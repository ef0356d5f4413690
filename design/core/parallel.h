// A parallel loop over contiguous blocks of an index range; what it computes must not depend on the thread count.
#pragma once

#include <cstddef>
#include <functional>

namespace lightmill {

/// Threads used by parallel loops: the machine's cores, or what set_thread_count() said.
int thread_count();
void set_thread_count(int count);

/// Calls body(begin, end) for consecutive blocks of at most `block` indices that cover [0, count), on all threads.
/// The blocks do not depend on the thread count, so a reduction over blocks in order is reproducible.
/// The first exception thrown by a body is rethrown here.
void parallel_blocks(std::size_t count, std::size_t block, const std::function<void(std::size_t begin, std::size_t end)>& body);

}  // namespace lightmill
