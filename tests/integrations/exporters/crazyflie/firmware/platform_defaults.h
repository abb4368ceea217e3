/* Stand-in: what the firmware knows of a Crazyflie. */
#pragma once

#define ARM_LENGTH 0.046f
#define THRUST_MAX 0.12f
#define THRUST2TORQUE 0.005964552f
