/* Priorities, preemption, tail-chaining, PRIMASK, what is pushed and popped, and sleep. */
#include "program.h"

#define ISER0 REG(0xE000E100)
#define ISPR0 REG(0xE000E200)
#define BARRIER() __asm volatile("isb" ::: "memory") /* what is pending comes before what follows */
#define PRIORITY(n) BYTE(0xE000E400 + (n))

static void on_first(void) {
    say(10);
    ISPR0 = 1 << 1; /* of higher priority: comes now */
    BARRIER();
    say(12);
    ISPR0 = 1 << 2; /* of the same: waits */
    BARRIER();
    say(13);
}

static void on_urgent(void) {
    say(11);
}

static void on_third(void) {
    unsigned number;
    __asm volatile("mrs %0, ipsr" : "=r"(number));
    say(number);
}

/* Leaves nothing as it was in what the processor has to restore. */
static void on_spoiling(void) {
    __asm volatile("mov r0, #99\n mov r1, #99\n mov r2, #99\n mov r3, #99\n mov r12, #99\n cmp r0, #0"
                   ::: "r0", "r1", "r2", "r3", "r12", "cc");
}

static void on_tick(void) {
    say(30);
}

VECTORS([15] = on_tick, [16] = on_first, [17] = on_urgent, [18] = on_third, [19] = on_spoiling);

/* 1 + 2 + 3 + 4 + 5, where r0 to r3, r12 and the flags outlast an interrupt between; the stack is at
 * 4 bytes and not at 8 meanwhile. */
static unsigned interrupted(void) {
    unsigned sum;
    register volatile unsigned *pend __asm("r4") = &ISPR0;
    register unsigned bit __asm("r5") = 1 << 3;
    __asm volatile("sub sp, #4\n mov r0, #1\n mov r1, #2\n mov r2, #3\n mov r3, #4\n mov r12, #5\n"
                   "cmp r0, r0\n str r5, [r4]\n isb\n"
                   "it ne\n movne r0, #50\n add sp, #4\n"
                   "add r0, r1\n add r0, r2\n add r0, r3\n add %0, r0, r12\n"
                   : "=r"(sum)
                   : "r"(pend), "r"(bit)
                   : "r0", "r1", "r2", "r3", "r12", "cc", "memory");
    return sum;
}

void on_reset(void) {
    OUT[0] = 0;
    PRIORITY(0) = PRIORITY(2) = PRIORITY(3) = 0x80;
    PRIORITY(1) = 0x40;
    ISER0 = 0xF;
    say(1);
    ISPR0 = 1 << 0;
    BARRIER();
    say(2);
    __asm volatile("cpsid i" ::: "memory");
    ISPR0 = 1 << 1;
    BARRIER();
    say(3);
    __asm volatile("cpsie i" ::: "memory");
    say(4);
    say(interrupted());
    REG(0xE000E014) = 16000 - 1; /* SysTick: a millisecond of HSI */
    REG(0xE000E018) = 0;
    REG(0xE000E010) = 7;
    for (;;) {
        __asm volatile("wfi" ::: "memory");
        say(31);
    }
}
