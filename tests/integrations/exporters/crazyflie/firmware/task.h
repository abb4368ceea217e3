/* Stand-in. */
#pragma once

#include "FreeRTOS.h"

void vTaskDelay(const uint32_t ticks);
