/* Stand-in. */
#pragma once

#include <stdint.h>

#define pdMS_TO_TICKS(MILLISECONDS) ((uint32_t)(MILLISECONDS))
