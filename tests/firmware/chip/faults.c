/* Each way into HardFault, and a fault in its handler. */
#include "program.h"

static void on_fault(void) {
    unsigned number;
    __asm volatile("mrs %0, ipsr" : "=r"(number));
    say(number);
    say(REG(0xE000ED28)); /* CFSR */
    say(REG(0xE000ED38)); /* BFAR */
    if (IN == 3) {
        (void)REG(0x60000000);
    }
    for (;;) {
    }
}

VECTORS([3] = on_fault);

void on_reset(void) {
    OUT[0] = 0;
    if (IN == 0 || IN == 3) {
        (void)REG(0x60000004);
    } else if (IN == 1) {
        __asm volatile("udf #0");
    } else if (IN == 2) {
        ((void (*)(void))0x60000001)();
    } else if (IN == 4) {
        REG(0x40000028) = 79; /* TIM2.PSC, and RCC has not been asked for its clock */
    }
    if (IN == 5) {
        REG(0x08001000) = 1;
    }
    for (;;) {
        __asm volatile("wfi");
    }
}
