#pragma once
// Where processor time goes, by stage ("first hits", "labels depth", "encode depth", ...). Costs one look at a flag while
// nobody listens.
//
// To have a stage reported: a StageTimer in the scope that does it.
#include <map>
#include <string>

namespace moomill {

// Listens from construction to destruction; one at a time in a program. What a stage takes is the processor time of the
// threads that entered it: all of it where the work has one thread, and less than all where others help inside a stage.
class StageTimes {
 public:
  StageTimes();
  ~StageTimes();
  StageTimes(const StageTimes&) = delete;
  StageTimes& operator=(const StageTimes&) = delete;
  std::map<std::string, double> seconds() const;  // by stage, those that ran
};

class StageTimer {
 public:
  // The stage's name, and whose it is where there are several ("labels", "depth").
  explicit StageTimer(const char* stage, const std::string& detail = {});
  ~StageTimer();
  StageTimer(const StageTimer&) = delete;
  StageTimer& operator=(const StageTimer&) = delete;

 private:
  std::string name_;  // empty while nobody listens
  double start_ = 0;
};

double thread_processor_seconds();   // of the calling thread, so far
double process_processor_seconds();  // of all threads of this process, so far

}  // namespace moomill
