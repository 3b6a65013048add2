#include "neural/config.h"
