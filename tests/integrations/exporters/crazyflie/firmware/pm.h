/* Stand-in: the battery. */
#pragma once

float pmGetBatteryVoltage(void); /* [V] */
