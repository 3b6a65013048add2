#include "validate/checks.h"
