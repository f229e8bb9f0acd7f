/* From reset to main, and where every interrupt goes (RM0440, vector table; ARMv7-M). */
#include <stddef.h>

#include "../board.h"
#include "interrupts.h"

/* Of link.ld. */
extern uint32_t _stack_end;
extern uint32_t _data_load;
extern uint32_t _data;
extern uint32_t _data_end;
extern uint32_t _bss;
extern uint32_t _bss_end;

/* Compilers call these two for whole structures. */
void *memcpy(void *to, const void *from, size_t count) {
    for (size_t i = 0; i < count; i++) {
        ((volatile uint8_t *)to)[i] = ((const uint8_t *)from)[i];
    }
    return to;
}

void *memset(void *to, int value, size_t count) {
    for (size_t i = 0; i < count; i++) {
        ((volatile uint8_t *)to)[i] = (uint8_t)value;
    }
    return to;
}

void on_reset(void) {
    (void)memcpy(&_data, &_data_load, (size_t)((uint8_t *)&_data_end - (uint8_t *)&_data));
    (void)memset(&_bss, 0, (size_t)((uint8_t *)&_bss_end - (uint8_t *)&_bss));
    (void)main();
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
