/* Flies an exported policy on the emulated board. What it reads and writes are files of float32 and uint32, by semihosting:
 *
 * observations: observations for the network.
 * histories:    some times the last action and STEPS measurements with their set-points.
 * verdict:      1 where the self test passes; else 0, and nothing else is written.
 * actions:      the network's actions and memories, one for each observation.
 * flown:        for each step the history, the action and the command.
 * costs:        ticks of a loop of 2 LOOPS instructions; calls timed; ticks of that many calls of mf_network, of mf_policy_step; bytes of
 *               a state; bytes of stack of mf_policy_step and of mf_policy_self_test. */
#include <stddef.h>
#include <stdint.h>

#include "policy.h"

#ifndef MF_MEMORY
#define MF_MEMORY 0
#endif
#ifndef STEPS
#error "STEPS: how many steps a history has"
#endif
#define LOOPS 100000
#define BLOCK 100
#define UNTOUCHED UINT32_C(0xA5C3F00D)

extern uint32_t bss_end[];
void stop(int status);
int main(void);

/* Operations of "Semihosting for AArch32 and AArch64", Arm. */
enum { OPEN = 0x01, CLOSE = 0x02, WRITE = 0x05, READ = 0x06, EXIT = 0x18 };
enum { READ_BINARY = 1, WRITE_BINARY = 5 };

static int32_t host(uint32_t operation, const void *arguments)
{
    register uint32_t first __asm("r0") = operation;
    register const void *second __asm("r1") = arguments;
    __asm volatile("bkpt 0xAB" : "+r"(first) : "r"(second) : "memory");
    return (int32_t)first;
}

void stop(int status)
{
    host(EXIT, (const void *)(status == 0 ? 0x20026 : 0x20023)); /* ADP_Stopped_ApplicationExit, ADP_Stopped_RunTimeErrorUnknown */
    for (;;) {
    }
}

static uint32_t opened(const char *name, uint32_t mode)
{
    uint32_t length = 0;
    while (name[length] != '\0') {
        length++;
    }
    const uint32_t arguments[] = {(uint32_t)name, mode, length};
    const int32_t file = host(OPEN, arguments);
    if (file < 0) {
        stop(1);
    }
    return (uint32_t)file;
}

static void closed(uint32_t file)
{
    host(CLOSE, &file);
}

static void written(uint32_t file, const void *bytes, uint32_t count)
{
    const uint32_t arguments[] = {file, (uint32_t)bytes, count};
    if (host(WRITE, arguments) != 0) {
        stop(1);
    }
}

/* How many of the bytes there were. */
static uint32_t filled(uint32_t file, void *bytes, uint32_t count)
{
    const uint32_t arguments[] = {file, (uint32_t)bytes, count};
    return count - (uint32_t)host(READ, arguments);
}

static float observations[BLOCK][MF_OBSERVATION_SIZE];
static float actions[BLOCK][MF_ACTION_SIZE + MF_MEMORY];
static mf_observation moments[BLOCK];
static mf_policy_state state;

static void evaluate(void)
{
    const uint32_t from = opened("observations", READ_BINARY), to = opened("actions", WRITE_BINARY);
    for (uint32_t count; (count = filled(from, observations, sizeof observations) / sizeof observations[0]) > 0;) {
        for (uint32_t i = 0; i < count; i++) {
            mf_network(observations[i], actions[i]);
        }
        written(to, actions, count * sizeof actions[0]);
    }
    closed(from);
    closed(to);
}

static void fly(void)
{
    const uint32_t from = opened("histories", READ_BINARY), to = opened("flown", WRITE_BINARY);
    float last_action[MF_ACTION_SIZE], command[MF_ACTION_SIZE];
    while (filled(from, last_action, sizeof last_action) == sizeof last_action) {
        mf_policy_reset(&state, last_action);
        for (uint32_t step = 0; step < STEPS; step++) {
            mf_observation *const now = &moments[step % BLOCK];
            if (filled(from, now, sizeof *now) != sizeof *now || !mf_policy_step(&state, now, command)) {
                stop(1);
            }
            written(to, state.history, sizeof state.history);
            written(to, state.action, sizeof state.action);
            written(to, command, sizeof command);
        }
    }
    closed(from);
    closed(to);
}

/* SysTick counts down 24 bits at the processor's clock (ARMv7-M Architecture Reference Manual, B3.3). */
static void timer_started(void)
{
    volatile uint32_t *const systick = (volatile uint32_t *)0xE000E010;
    systick[1] = 0xFFFFFF;
    systick[2] = 0;
    systick[0] = 5;
}

static void call_loop(void)
{
    uint32_t left = LOOPS;
    __asm volatile("1: subs %0, %0, #1\n bne 1b" : "+r"(left)::"cc");
}

static void call_networks(void)
{
    for (uint32_t i = 0; i < BLOCK; i++) {
        mf_network(observations[i], actions[i]);
    }
}

static void call_steps(void)
{
    float command[MF_ACTION_SIZE];
    for (uint32_t i = 0; i < BLOCK; i++) {
        mf_policy_step(&state, &moments[i], command);
    }
}

static void call_step(void)
{
    static float command[MF_ACTION_SIZE];
    mf_policy_step(&state, &moments[0], command);
}

static void call_self_test(void)
{
    mf_policy_self_test();
}

static uint32_t ticks(void (*call)(void))
{
    volatile const uint32_t *const counter = (volatile const uint32_t *)0xE000E018;
    const uint32_t begin = *counter;
    call();
    return (begin - *counter) & 0xFFFFFF;
}

/* Bytes below this function's frame that a call writes: what lies between the variables and the stack is marked, then looked through. */
__attribute__((noinline)) static uint32_t stack_used(void (*call)(void))
{
    volatile uint32_t *top, *word;
    __asm volatile("mov %0, sp" : "=r"(top));
    for (word = bss_end; word < top; word++) {
        *word = UNTOUCHED;
    }
    call();
    for (word = bss_end; word < top && *word == UNTOUCHED; word++) {
    }
    return (uint32_t)(top - word) * sizeof *word;
}

static void measure(void)
{
    timer_started();
    const uint32_t costs[] = {
        ticks(call_loop), BLOCK, ticks(call_networks), ticks(call_steps), sizeof state, stack_used(call_step), stack_used(call_self_test),
    };
    const uint32_t to = opened("costs", WRITE_BINARY);
    written(to, costs, sizeof costs);
    closed(to);
}

int main(void)
{
    const uint32_t intact = mf_policy_self_test() ? 1 : 0;
    const uint32_t to = opened("verdict", WRITE_BINARY);
    written(to, &intact, sizeof intact);
    closed(to);
    if (intact) {
        evaluate();
        fly();
        measure();
    }
    return 0;
}
