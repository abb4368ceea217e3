/* Brings a Cortex-M4F from reset to main, with nothing from a library. */
#include <stdint.h>

extern uint32_t stack_top[], data_begin[], data_end[], data_image[], bss_begin[], bss_end[];

int main(void);
void stop(int status);
void reset(void);
void fault(void);

void reset(void)
{
    /* CPACR: full access to the floating-point unit, coprocessors 10 and 11 (ARMv7-M Architecture Reference Manual, B3.2.20). */
    *(volatile uint32_t *)0xE000ED88 |= UINT32_C(0xF) << 20;
    __asm volatile("dsb\n isb" ::: "memory");
    for (uint32_t i = 0; data_begin + i < data_end; i++) {
        data_begin[i] = data_image[i];
    }
    for (uint32_t *word = bss_begin; word < bss_end; word++) {
        *word = 0;
    }
    stop(main());
}

void fault(void)
{
    stop(1);
}

/* Initial stack, reset, NMI and the four faults (B1.5.3). */
__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    void (*handlers[6])(void);
} vectors = {stack_top, {reset, fault, fault, fault, fault, fault}};
