/* From reset to main, and where every interrupt goes (RM0440, vector table; ARMv7-M). */
#include <stddef.h>

#include "../board.h"
#include "registers.h"

extern uint32_t _stack_end, _data_load, _data, _data_end, _bss, _bss_end;

int main(void);
void on_reset(void);
void on_tick(void), on_can(void), on_wake(void), on_scan(void), on_toggle(void);

/* Compilers call these two for whole structures. */
void *memcpy(void *restrict to, const void *restrict from, size_t count) {
    for (volatile uint8_t *out = to; count-- > 0;) {
        *out++ = *(const uint8_t *)from;
        from = (const uint8_t *)from + 1;
    }
    return to;
}

void *memset(void *to, int value, size_t count) {
    for (volatile uint8_t *out = to; count-- > 0;) {
        *out++ = (uint8_t)value;
    }
    return to;
}

void on_reset(void) {
    for (uint32_t *from = &_data_load, *to = &_data; to < &_data_end;) {
        *to++ = *from++;
    }
    for (uint32_t *to = &_bss; to < &_bss_end;) {
        *to++ = 0;
    }
    main();
}

/* A fault of the processor, or an interrupt that nobody has asked for: everything off, and the
 * watchdog, which is fed no more, resets the board. */
static void on_fault(void) {
    board_on_fault();
    for (;;) {
    }
}

#define NONE(first, last) [16 + first... 16 + last] = on_fault

__attribute__((section(".vectors"), used)) static void (*const VECTORS[16 + 102])(void) = {
    (void (*)(void))&_stack_end, on_reset, on_fault, on_fault, on_fault, on_fault, on_fault,
    on_fault, on_fault, on_fault, on_fault, on_fault, on_fault, on_fault, on_fault, on_tick,
    NONE(0, 20), [16 + 21] = on_can, NONE(22, 27), [16 + 28] = on_toggle, NONE(29, 49),
    [16 + 50] = on_wake, NONE(51, 55), [16 + 56] = on_scan, NONE(57, 101)};
