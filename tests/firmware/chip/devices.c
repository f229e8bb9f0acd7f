/* Timers, DMA, ADC, CAN and watchdog together, as a board uses them; clock is HSI, 16 MHz. */
#include "program.h"

enum { RING = 8 };

#define RINGS ((volatile unsigned short *)0x2000A000)
#define SCANNED ((volatile unsigned short *)0x2000A100)
#define TIM2 0x40000000
#define TIM3 0x40000400
#define TIM5 0x40000C00
#define TIM6 0x40001000
#define TIM7 0x40001400
#define FDCAN 0x40006400
#define MESSAGES 0x4000A400
#define DMA1 0x40020000
#define ADC1 0x50000000

static void on_compare(void) {
    REG(TIM5 + 0x10) = 0;
    say(REG(TIM5 + 0x24));
    REG(TIM5 + 0x34) += 250;
}

static void on_once(void) {
    REG(TIM7 + 0x10) = 0;
    say(7);
}

static void on_scan(void) {
    REG(DMA1 + 0x04) = 0xF << 4;
    say(SCANNED[0] << 16 | SCANNED[1]);
}

/* Sends back what came, with the next identifier. */
static void on_can(void) {
    REG(FDCAN + 0x50) = REG(FDCAN + 0x50);
    while (REG(FDCAN + 0x90) & 0xF) {
        unsigned from = MESSAGES + 0xB0 + 72 * (REG(FDCAN + 0x90) >> 8 & 3);
        unsigned place = REG(FDCAN + 0xC4) >> 16 & 3, to = MESSAGES + 0x278 + 72 * place;
        REG(to) = REG(from) + 1;
        for (unsigned i = 4; i < 72; i += 4) {
            REG(to + i) = REG(from + i);
        }
        REG(FDCAN + 0x94) = REG(FDCAN + 0x90) >> 8 & 3;
        REG(FDCAN + 0xCC) = 1 << place;
    }
}

VECTORS([16 + 12] = on_scan, [16 + 21] = on_can, [16 + 50] = on_compare, [16 + 55] = on_once);

static void count_microseconds(unsigned timer) {
    REG(timer + 0x28) = 16 - 1;
    REG(timer + 0x14) = 1;
    REG(timer + 0x10) = 0;
}

static void capture(void) {
    REG(0x48000000) = 0xABFFFFFE; /* PA0: alternate function 1, TIM2_CH1 */
    REG(0x48000020) = 1;
    for (unsigned i = 0; i < 2; i++) { /* rising edges to the first ring, falling ones to the other */
        unsigned channel = DMA1 + 0x08 + 0x14 * i;
        REG(0x40020800 + 4 * i) = 56 + i;
        REG(channel + 4) = RING;
        REG(channel + 8) = TIM2 + 0x34 + 4 * i;
        REG(channel + 12) = (unsigned)&RINGS[RING * i];
        REG(channel) = 1 << 10 | 2 << 8 | 1 << 7 | 1 << 5 | 1;
    }
    REG(TIM2 + 0x18) = 0x0201;
    REG(TIM2 + 0x20) = 0x0031;
    REG(TIM2 + 0x0C) = 3 << 9;
    REG(TIM2 + 0x00) = 1;
}

static void compare(void) {
    REG(0xE000E104) = 1 << (50 - 32) | 1 << (55 - 32);
    count_microseconds(TIM5);
    REG(TIM5 + 0x34) = 500;
    REG(TIM5 + 0x0C) = 2;
    REG(TIM5 + 0x00) = 1;
    count_microseconds(TIM7); /* one pulse of 2 ms */
    REG(TIM7 + 0x2C) = 2000 - 1;
    REG(TIM7 + 0x0C) = 1;
    REG(TIM7 + 0x00) = 1 << 3 | 1;
}

/* TIM3 begins as TIM2 does, and turns PA6 over each time it comes to 100. */
static void toggle(void) {
    REG(0x48000000) = 0xABFFEFFF;
    REG(0x48000020) = 2 << 24;
    count_microseconds(TIM2);
    count_microseconds(TIM3);
    REG(TIM3 + 0x2C) = 300 - 1;
    REG(TIM3 + 0x34) = 100;
    REG(TIM3 + 0x18) = 3 << 4;
    REG(TIM3 + 0x20) = 1;
    REG(TIM3 + 0x08) = 1 << 4 | 6;
    REG(TIM2 + 0x04) = 1 << 4;
    say(REG(TIM3 + 0x00) & 1);
    REG(TIM2 + 0x00) = 1;
    say(REG(TIM3 + 0x00) & 1);
}

/* PC0 sixteen times oversampled and PC1, each millisecond. */
static void scan(void) {
    REG(0xE000E100) = 1 << 12;
    REG(0x40020804) = 5;
    REG(DMA1 + 0x20) = 2;
    REG(DMA1 + 0x24) = ADC1 + 0x40;
    REG(DMA1 + 0x28) = (unsigned)SCANNED;
    REG(DMA1 + 0x1C) = 1 << 10 | 2 << 8 | 1 << 7 | 1 << 5 | 2 | 1;
    REG(0x50000308) = 1 << 16;
    REG(ADC1 + 0x08) = 0;
    REG(ADC1 + 0x08) = 1u << 28;
    REG(ADC1 + 0x08) = 1u << 31 | 1u << 28;
    while (REG(ADC1 + 0x08) >> 31) {
    }
    REG(ADC1 + 0x08) = 1u << 28 | 1;
    while (!(REG(ADC1) & 1)) {
    }
    REG(ADC1 + 0x14) = 3 << 18 | 3 << 21; /* 24.5 clocks: sources of 1 kohm */
    REG(ADC1 + 0x30) = 7 << 12 | 6 << 6 | 1;
    REG(ADC1 + 0x10) = 3 << 2 | 1;
    REG(ADC1 + 0x0C) = 1u << 31 | 1 << 10 | 13 << 5 | 1 << 1 | 1;
    REG(ADC1 + 0x08) = 1u << 28 | 1 << 2 | 1;
    count_microseconds(TIM6);
    REG(TIM6 + 0x2C) = 1000 - 1;
    REG(TIM6 + 0x04) = 2 << 4;
    REG(TIM6 + 0x00) = 1;
}

static void echo(void) {
    REG(0xE000E100) = 1 << 21;
    REG(0x48000000) = 0xAABFFFFF;
    REG(0x48000024) = 0x00099000;
    REG(0x40021088) = 2 << 24; /* the bus clock, which is HSI here: 16 MHz */
    REG(FDCAN + 0x18) = 1;
    REG(FDCAN + 0x18) = 3;
    REG(FDCAN + 0x18) = 3 | 1 << 8 | 1 << 9;
    REG(FDCAN + 0x1C) = 0 << 25 | 1 << 16 | 11 << 8 | 2; /* 16 quanta of 125 ns, 13 before */
    REG(FDCAN + 0x0C) = 0 << 16 | 4 << 8 | 1 << 4;        /* 8 quanta of 62.5 ns, 6 before */
    REG(FDCAN + 0xDC) = 7;
    REG(FDCAN + 0x54) = 1;
    REG(FDCAN + 0x5C) = 1;
    REG(FDCAN + 0x18) = 1 << 8 | 1 << 9;
}

static void guard(void) {
    REG(0x40003000) = 0xCCCC;
    REG(0x40003000) = 0x5555;
    REG(0x40003004) = 0;
    REG(0x40003008) = 15;
    REG(0x40003010) = 12;
}

void on_reset(void) {
    static void (*const parts[])(void) = {capture, compare, toggle, scan, echo, guard};
    OUT[0] = 0;
    say(REG(0x40021094)); /* RCC.CSR: why it was reset */
    REG(0x40021048) = 0x107;
    REG(0x4002104C) = 1 << 13 | 7;
    REG(0x40021058) = 0x0200043F;
    parts[IN]();
    for (;;) {
        __asm volatile("wfi");
    }
}
