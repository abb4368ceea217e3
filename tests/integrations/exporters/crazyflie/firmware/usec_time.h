/* Stand-in: microseconds since power-on. */
#pragma once

#include <stdint.h>

uint64_t usecTimestamp(void);
