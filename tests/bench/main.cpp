#include <benchmark/benchmark.h>

#include "generator/core/parallel.h"

bool run_memory_child();      // tracing.cpp
void remove_bench_scratch();  // tracing.cpp

int main(int argc, char** argv) {
  moomill::keep_memory_flat();
  if (run_memory_child()) return 0;
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  benchmark::RunSpecifiedBenchmarks();
  remove_bench_scratch();
  return 0;
}
