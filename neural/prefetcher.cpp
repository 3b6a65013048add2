#include <omp.h>

#include <algorithm>
#include <condition_variable>
#include <deque>
#include <exception>
#include <mutex>
#include <thread>

#include "neural/samples.h"

namespace moomill {

struct Prefetcher::State {
  const SampleSource& source;
  SampleOptions options;
  int epoch, index;
  std::size_t ahead;
  std::mutex mutex;
  std::condition_variable changed;
  std::deque<Batch> ready;
  std::exception_ptr error;
  bool stop = false;
  std::thread thread;

  void run() {
    // One thread: the others are busy training. LibTorch sets the team of a new thread at its first use; after that,
    // ours holds.
    at::internal::lazy_init_num_threads();
    omp_set_num_threads(1);
    try {
      const int batches = source.batches_per_epoch(options);
      for (;;) {
        for (; index >= batches; index -= batches) ++epoch;
        Batch batch = source.batch(options, epoch, index++);
        std::unique_lock lock(mutex);
        changed.wait(lock, [&] { return stop || ready.size() < ahead; });
        if (stop) return;
        ready.push_back(std::move(batch));
        changed.notify_all();
      }
    } catch (...) {
      std::lock_guard lock(mutex);
      error = std::current_exception();
      changed.notify_all();
    }
  }
};

Prefetcher::Prefetcher(const SampleSource& source, SampleOptions options, int epoch, int index, int ahead)
    : state_(new State{source,
                       std::move(options),
                       epoch,
                       index,
                       static_cast<std::size_t>(std::max(ahead, 1)),
                       {},
                       {},
                       {},
                       {},
                       false,
                       {}}) {
  state_->thread = std::thread([s = state_.get()] { s->run(); });
}

Prefetcher::~Prefetcher() {
  {
    std::lock_guard lock(state_->mutex);
    state_->stop = true;
  }
  state_->changed.notify_all();
  state_->thread.join();
}

Batch Prefetcher::next() {
  State& s = *state_;
  std::unique_lock lock(s.mutex);
  s.changed.wait(lock, [&] { return !s.ready.empty() || s.error; });
  if (s.ready.empty()) std::rethrow_exception(s.error);
  Batch batch = std::move(s.ready.front());
  s.ready.pop_front();
  s.changed.notify_all();
  return batch;
}

}  // namespace moomill
