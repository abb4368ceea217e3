/* Stand-in. */
#pragma once

#include <stdint.h>

#define portMAX_DELAY UINT32_C(0xffffffff)
