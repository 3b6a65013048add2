#pragma once
// Threads (oneTBB) and the floating-point state all of them share.
#include <tbb/blocked_range.h>
#include <tbb/global_control.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <cstddef>

namespace moomill {

// Sets flush-to-zero and denormals-are-zero on this thread (Embree wants both; results must not depend on which
// thread did the work, so every worker has them).
void set_float_state();

// Calls body(i) for i in [0, count), in any order, on the threads of the current arena. The body must not depend on
// the order. Isolated: a thread that waits inside does not pick up work of an outer loop, so memory stays bounded.
template <class Body>
void parallel_for(std::size_t count, std::size_t grain, const Body& body) {
  tbb::this_task_arena::isolate([&] {
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, count, grain), [&](const tbb::blocked_range<std::size_t>& r) {
      set_float_state();
      for (std::size_t i = r.begin(); i != r.end(); ++i) body(i);
    });
  });
}

// Has malloc hand images back to the system when they are freed, instead of keeping them in per-thread heaps that
// creep upwards for hours. For main(), once, before any thread starts.
void keep_memory_flat();

// The opposite, for programs that take and give back the same large tensors at every step: malloc keeps what it has, so that
// their pages are not mapped and cleared again and again.
void keep_memory_mapped();

// Cores this process may use.
int hardware_threads();

}  // namespace moomill
