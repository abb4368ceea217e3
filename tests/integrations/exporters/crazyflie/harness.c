/* Runs the app as the firmware's stabilizer does, with a PID of which one sees what it was given.
 *
 * The PID behaves as documented in three things: its attitude loop runs at 500 Hz and its position loop at 100 Hz, what they found
 * holds in between; a thrust of 0 stops all. Its thrust and torques are such that one knows them again. */
#include <setjmp.h>
#include <string.h>

#include "controller.h"
#include "controller_pid.h"
#include "app.h"
#include "log.h"
#include "param.h"
#include "platform_defaults.h"
#include "pm.h"
#include "task.h"
#include "usec_time.h"

#define CALLS 4

/* One step of the stabilizer. */
typedef struct {
    float position[3], quaternion[4], velocity[3], gyro[3];
    float wanted[3];
    float thrust; /* what the PID's position loop finds */
    int32_t modes[7];
    float acceleration[3]; /* [g] */
    float battery; /* [V] */
    float wanted_velocity[3], wanted_acceleration[3];
} given_t;

/* What the PID was asked, and when. */
typedef struct {
    float attitude[3], rate[3], thrust;
    int32_t modes[7];
    uint32_t step;
} asked_t;

typedef struct {
    float forces[4];
    float torque[3], thrust;
    int32_t mode;
    int32_t calls;
    asked_t asked[CALLS];
} found_t;

static control_t control;
static float position_thrust, actuator_thrust;
static found_t found;
static uint64_t now;
static float battery;
bool pid_sound = true;
int pid_begun;

void controllerPidInit(void)
{
    pid_begun++;
}

bool controllerPidTest(void)
{
    return pid_sound;
}

void controllerPid(control_t *out, const setpoint_t *setpoint, const sensorData_t *sensors, const state_t *state,
                   const stabilizerStep_t step)
{
    const asked_t asked = {
        {setpoint->attitude.roll, setpoint->attitude.pitch, setpoint->attitude.yaw},
        {setpoint->attitudeRate.roll, setpoint->attitudeRate.pitch, setpoint->attitudeRate.yaw},
        setpoint->thrust,
        {setpoint->mode.x, setpoint->mode.y, setpoint->mode.z, setpoint->mode.roll, setpoint->mode.pitch, setpoint->mode.yaw,
         setpoint->mode.quat},
        step,
    };
    (void)sensors;
    (void)state;
    if (found.calls < CALLS) {
        found.asked[found.calls] = asked;
    }
    found.calls++;
    out->controlMode = controlModeLegacy;
    if (step % (RATE_MAIN_LOOP / POSITION_RATE) == 0) {
        actuator_thrust = position_thrust;
    }
    if (step % (RATE_MAIN_LOOP / ATTITUDE_RATE) == 0) {
        if (setpoint->mode.z == modeDisable) {
            actuator_thrust = setpoint->thrust;
        }
        out->roll = 11;
        out->pitch = 22;
        out->yaw = 33;
    }
    out->thrust = actuator_thrust;
    if (out->thrust == 0) {
        out->roll = out->pitch = out->yaw = 0;
    }
}

float pmGetBatteryVoltage(void)
{
    return battery;
}

uint64_t usecTimestamp(void)
{
    return now += 123;
}

/* The app's own task runs up to its next delay, in which the test has the stabilizer run. */
static jmp_buf delayed;
static bool resumed;
static uint32_t delay;

void vTaskDelay(const uint32_t ticks)
{
    delay = ticks;
    if (!resumed) {
        longjmp(delayed, 1);
    }
    resumed = false;
}

uint32_t run_app(void);

uint32_t run_app(void)
{
    if (!setjmp(delayed)) {
        resumed = true;
        appMain();
    }
    return delay;
}

/* The motors' forces as the firmware mixes them, in shares of the most that 65535 counts stand for. */
static void mix(float *forces)
{
    const float arm = 0.707106781f * ARM_LENGTH;
    const float thrust = control.thrustSi, roll = control.torqueX / arm, pitch = control.torqueY / arm, yaw = control.torqueZ / THRUST2TORQUE;
    const float all[4] = {thrust - roll - pitch - yaw, thrust - roll + pitch + yaw, thrust + roll + pitch - yaw, thrust + roll - pitch + yaw};
    for (int i = 0; i < 4; i++) {
        forces[i] = 0.25f * all[i] / THRUST_MAX;
    }
}

void fly(uint32_t first, int count, const given_t *given, found_t *all);

void fly(uint32_t first, int count, const given_t *given, found_t *all)
{
    for (int i = 0; i < count; i++) {
        const given_t *in = &given[i];
        state_t state;
        sensorData_t sensors;
        setpoint_t setpoint;
        memset(&state, 0, sizeof state);
        memset(&sensors, 0, sizeof sensors);
        memset(&setpoint, 0, sizeof setpoint);
        state.position = (vector_t){in->position[0], in->position[1], in->position[2]};
        state.velocity = (vector_t){in->velocity[0], in->velocity[1], in->velocity[2]};
        state.attitudeQuaternion = (quaternion_t){in->quaternion[0], in->quaternion[1], in->quaternion[2], in->quaternion[3]};
        state.acc = (vector_t){in->acceleration[0], in->acceleration[1], in->acceleration[2]};
        battery = in->battery;
        sensors.gyro = (vector_t){in->gyro[0], in->gyro[1], in->gyro[2]};
        setpoint.position = (vector_t){in->wanted[0], in->wanted[1], in->wanted[2]};
        setpoint.velocity = (vector_t){in->wanted_velocity[0], in->wanted_velocity[1], in->wanted_velocity[2]};
        setpoint.acceleration = (vector_t){in->wanted_acceleration[0], in->wanted_acceleration[1], in->wanted_acceleration[2]};
        memcpy(&setpoint.mode, in->modes, sizeof setpoint.mode);
        position_thrust = in->thrust;
        memset(&found, 0, sizeof found);
        controllerOutOfTree(&control, &setpoint, &sensors, &state, first + (uint32_t)i);
        memcpy(found.forces, control.normalizedForces, sizeof found.forces);
        found.torque[0] = control.roll;
        found.torque[1] = control.pitch;
        found.torque[2] = control.yaw;
        found.thrust = control.thrust;
        found.mode = control.controlMode;
        if (control.controlMode == controlModeForceTorque) {
            mix(found.forces);
        }
        all[i] = found;
    }
}
