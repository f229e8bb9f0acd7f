/* What the programs of this folder have in common: each is an image of its own for the emulated
 * chip, written from the manuals and not from the board's layer in firmware/g474. */
#ifndef PROGRAM_H
#define PROGRAM_H

#define REG(address) (*(volatile unsigned *)(address))
#define BYTE(address) (*(volatile unsigned char *)(address))
#define OUT ((volatile unsigned *)0x20008000) /* what a program has to say: a count, then words */
#define IN REG(0x20009000)                    /* which part of a program is asked for */

extern unsigned _stack_end;
void on_reset(void);

static inline void say(unsigned word) {
    OUT[++OUT[0]] = word;
}

#define VECTORS(...)                                                                              \
    __attribute__((section(".vectors"), used)) static void (*const vectors[118])(void) = {        \
        (void (*)(void)) & _stack_end, on_reset, __VA_ARGS__}

#endif
