/* Stand-in for the firmware's header: those names of its documented interface that the app and its test use, and not its text. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

#define RATE_MAIN_LOOP 1000
#define ATTITUDE_RATE 500
#define POSITION_RATE 100

typedef uint32_t stabilizerStep_t;

typedef struct {
    float x, y, z;
} vector_t;

typedef struct {
    float x, y, z, w;
} quaternion_t;

typedef struct {
    float roll, pitch, yaw; /* [deg] */
} attitude_t;

typedef struct {
    attitude_t attitude; /* pitch positive nose up */
    quaternion_t attitudeQuaternion;
    vector_t position; /* [m] */
    vector_t velocity; /* [m/s] */
    vector_t acc; /* [g], world, without gravity */
} state_t;

typedef struct {
    vector_t acc;
    vector_t gyro; /* [deg/s] */
} sensorData_t;

typedef enum { modeDisable = 0, modeAbs, modeVelocity } stab_mode_t;

typedef struct {
    attitude_t attitude;     /* pitch positive nose up */
    attitude_t attitudeRate; /* [deg/s]; pitch positive nose up */
    quaternion_t attitudeQuaternion;
    float thrust; /* 0 to 65535 */
    vector_t position;
    vector_t velocity;
    vector_t acceleration; /* [m/s^2] */
    bool velocity_body;
    struct {
        stab_mode_t x, y, z, roll, pitch, yaw, quat;
    } mode;
} setpoint_t;

typedef enum { controlModeLegacy = 0, controlModeForceTorque, controlModeForce } control_mode_t;

/* Forces lie where roll, pitch, yaw and thrust lie. */
typedef struct {
    union {
        struct {
            int16_t roll, pitch, yaw;
            float thrust;
        };
        struct {
            float thrustSi, torqueX, torqueY, torqueZ;
        };
        float normalizedForces[4];
    };
    control_mode_t controlMode;
} control_t;
