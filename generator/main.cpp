#include <cstdio>

int main() {
  std::puts("moomill " MOOMILL_VERSION);
  return 0;
}
