/* Clocks, pins, timers, converters, CAN and watchdog of the board, and the main loop. */
#include "../board.h"
#include "../frames.h"
#include "interrupts.h"
#include "memory.h"
#include "registers.h"

enum { OUTPUT = 1, ALTERNATE = 2 }; /* of MODER; from reset pins are analogue */

static void pin(struct gpio *port, unsigned number, uint32_t mode, uint32_t function) {
    port->AFR[number / 8] |= function << 4 * (number % 8);
    port->MODER = (port->MODER & ~(UINT32_C(3) << 2 * number)) | mode << 2 * number;
}

static void wait_for(const reg *status, uint32_t bit) {
    while (!(*status & bit)) {
    }
}

/* 24 MHz of the crystal / 6 * 40 / 2: a CAN bus needs better than the built-in oscillator. */
static void start_clocks(void) {
    *FLASH_ACR = (*FLASH_ACR & ~UINT32_C(15)) | 2; /* wait states of 80 MHz */
    RCC->CR |= BIT(16);
    wait_for(&RCC->CR, BIT(17));
    RCC->PLLCFGR = 3 | FIELD(5, 4) | FIELD(40, 8) | BIT(24);
    RCC->CR |= BIT(24);
    wait_for(&RCC->CR, BIT(25));
    RCC->CFGR |= 3;
    wait_for(&RCC->CFGR, BIT(3));
    RCC->AHB1ENR |= BIT(0) | BIT(1) | BIT(2);                     /* DMA1, DMA2, DMAMUX */
    RCC->AHB2ENR |= BIT(0) | BIT(1) | BIT(2) | BIT(13);           /* GPIOA, B, C, ADC1 and 2 */
    RCC->APB1ENR1 |= BIT(0) | BIT(1) | BIT(3) | BIT(4) | BIT(25); /* TIM2, 3, 5, 6, FDCAN */
    RCC->CCIPR |= FIELD(2, 24);                                   /* FDCAN by PCLK1 */
}

static void start_pins(void) {
    for (unsigned i = 6; i <= 12; i++) {
        pin(GPIOC, i, OUTPUT, 0);
    }
    for (unsigned i = 13; i <= 15; i++) {
        pin(GPIOB, i, OUTPUT, 0);
    }
    pin(GPIOA, 8, OUTPUT, 0); /* the wire to a second board */
    pin(GPIOA, 11, ALTERNATE, 9);
    pin(GPIOA, 12, ALTERNATE, 9);
    pin(GPIOA, 0, ALTERNATE, 1);
    pin(GPIOB, 10, ALTERNATE, 1);
#if IMAGE_TEETH
    pin(GPIOA, 1, ALTERNATE, 1);
    pin(GPIOB, 11, ALTERNATE, 1);
#else
    pin(GPIOA, 6, ALTERNATE, 2);
    pin(GPIOB, 0, ALTERNATE, 2);
#endif
}

static void count_microseconds(struct tim *tim) {
    tim->PSC = MHZ - 1;
    tim->ARR = tim == TIM2 || tim == TIM5 ? UINT32_MAX : UINT16_MAX; /* as wide as they are */
    tim->EGR = BIT(0); /* the prescaler is taken over */
    tim->SR = 0;
}

#if IMAGE_TEETH
static void start_wheels(void) { /* four outputs, low until they toggle */
    TIM2->CCER = 0x1111;
}

static void start_converters(void) { /* their inputs are such outputs */
}
#else
/* 32 bits from a register, all or 16 of them to memory, around in a circle. */
enum { WHOLE = 0x800, HALF = 0x400, COMPLETE = 2 };

static void start_ring(struct dma *dma, unsigned channel, uint32_t request, reg *from,
                       uint32_t to, uint32_t count, uint32_t options) {
    DMAMUX[channel + (dma == DMA2 ? 8 : 0)] = request;
    dma->CH[channel].CPAR = (uint32_t)from;
    dma->CH[channel].CMAR = to;
    dma->CH[channel].CNDTR = count;
    dma->CH[channel].CCR = BIT(0) | BIT(5) | BIT(7) | BIT(9) | options;
}

/* Both edges of two inputs: units 1 and 2 capture the first one's, 3 and 4 the third one's. */
static void start_capture(struct tim *tim, unsigned first, uint32_t request) {
    for (unsigned i = 0; i < 4; i++) {
        start_ring(DMA1, first + i, request + i, &tim->CCR[i], (uint32_t)edges_low_us[first + i],
                   RING, HALF);
    }
    tim->CCMR[0] = 0x0201;
    tim->CCMR[1] = 0x0201;
    tim->CCER = 0x3131;
    tim->DIER = BIT(9) | BIT(10) | BIT(11) | BIT(12);
}

static void start_wheels(void) {
    start_capture(TIM2, 0, 56);
    start_capture(TIM3, 4, 61);
}

static void wait_us(unsigned us) { /* at least */
    for (volatile unsigned left = us * MHZ; left > 0; left--) {
    }
}

static void start_adc(struct adc *adc, uint32_t oversampling) {
    adc->CR = 0; /* out of deep sleep */
    adc->CR = BIT(28);
    wait_us(20);
    adc->CR |= BIT(31); /* calibrates itself */
    while ((adc->CR & BIT(31)) != 0) {
    }
    wait_us(1);
    adc->ISR = BIT(0);
    adc->CR |= BIT(0);
    wait_for(&adc->ISR, BIT(0));
    adc->CFGR = BIT(0) | BIT(1) | FIELD(13, 5) | BIT(10) | BIT(12); /* by TIM6, to the ring */
    adc->CFGR2 = oversampling;
    adc->CR |= BIT(2);
}

static void start_converters(void) {
    *ADC12_CCR = FIELD(2, 16); /* 40 MHz */
    /* Transmitters are sampled for 24.5 clocks, 0.61 us: the data sheet wants 0.41 us for 1.2 kohm
     * before the pin. 16 times 24.5 + 12.5 of them are 14.8 us an input, 0.12 ms for all. */
    ADC1->SMPR[0] = FIELD(3, 6) | FIELD(3, 18) | FIELD(3, 21) | FIELD(3, 24) | FIELD(3, 27);
    ADC1->SMPR[1] = FIELD(3, 3) | FIELD(3, 6) | FIELD(3, 12);
    /* The Hall lines' levels for 92.5, 2.3 us: 1.6 us for 3.9 kohm. */
    ADC2->SMPR[0] = FIELD(5, 12) | FIELD(5, 15);
    ADC2->SMPR[1] = FIELD(5, 3) | FIELD(5, 21);
    ADC1->SQR[0] = 7 | FIELD(6, 6) | FIELD(7, 12) | FIELD(8, 18) | FIELD(9, 24);
    ADC1->SQR[1] = 12 | FIELD(14, 6) | FIELD(11, 12) | FIELD(2, 18);
    ADC2->SQR[0] = 3 | FIELD(4, 6) | FIELD(5, 12) | FIELD(11, 18) | FIELD(17, 24);
    start_ring(DMA2, 0, 5, &ADC1->DR, (uint32_t)scans_raw[0], TRANSMITTERS * HAL_SCANS,
               HALF | COMPLETE);
    start_ring(DMA2, 1, 36, &ADC2->DR, (uint32_t)levels_raw, HAL_WHEELS, HALF);
    start_ring(DMA2, 2, 8, &TIM2->CNT, (uint32_t)&scanned_us, 1, WHOLE); /* as TIM6 comes round */
    start_adc(ADC1, BIT(0) | FIELD(3, 2)); /* 16 samples added */
    start_adc(ADC2, 0);
}
#endif

static void start_timers(void) {
    count_microseconds(TIM2);
    count_microseconds(TIM3);
    count_microseconds(TIM5);
    count_microseconds(TIM6);
    start_wheels();
    TIM3->SMCR = 6 | FIELD(1, 4); /* started by TIM2, it is the lower half of it */
    TIM2->CR2 = FIELD(1, 4);
    TIM6->ARR = 1000 - 1; /* a scan each millisecond */
    TIM6->CR2 = FIELD(2, 4);
    TIM6->DIER = BIT(8);
    TIM5->DIER = BIT(1) | BIT(2); /* two times at which to wake */
    TIM2->CR1 = BIT(0);
    TIM5->CR1 = BIT(0);
}

static void hear(unsigned filter, uint32_t first_id, uint32_t last_id) {
    FDCAN1_RAM->extended_filters[2 * filter] = BIT(29) | first_id;
    FDCAN1_RAM->extended_filters[2 * filter + 1] = last_id;
}

/* 500 kbit/s of 80 quanta, sampled at 80 %, and on a classic bus at 87.5 %; 2 Mbit/s of 20, sampled
 * at 80 %. */
#if PROFILE_CLASSIC
enum { CAN_FD = 0, SAMPLED_AT = 70 };
#else
enum { CAN_FD = 0x300, SAMPLED_AT = 64 };
#endif

static void start_can(void) {
    FDCAN1->CCCR = BIT(0);
    wait_for(&FDCAN1->CCCR, BIT(0));
    FDCAN1->CCCR = BIT(0) | BIT(1);
    FDCAN1->CCCR = BIT(0) | BIT(1) | CAN_FD;
    FDCAN1->NBTP = FIELD(79 - SAMPLED_AT, 25) | FIELD(1, 16) | FIELD(SAMPLED_AT - 2, 8) |
                   (79 - SAMPLED_AT);
    FDCAN1->DBTP = BIT(23) | FIELD(1, 16) | FIELD(14, 8) | FIELD(3, 4) | 3;
    FDCAN1->TDCR = FIELD(32, 8); /* the transmitter looks at its own bit at 80 % too */
    /* Nothing is heard but what one of two filters lets through. */
    FDCAN1->RXGFC = BIT(0) | BIT(1) | FIELD(2, 2) | FIELD(2, 4) | FIELD(2, 24);
    hear(0, 0x0CFF4003, 0x0CFF9103); /* commands, of either profile */
    hear(1, 0x18FF1080, 0x18FF2080); /* edges and the sensors' time: teeth, a second board */
    FDCAN1->TXBC = BIT(24); /* buffers that can be taken back */
    FDCAN1->TXBTIE = 7;
    FDCAN1->IE = BIT(0) | BIT(7) | BIT(19); /* received, sent, off the bus */
    FDCAN1->ILE = BIT(0);
    FDCAN1->CCCR &= ~BIT(0);
}

/* 2 ms by an oscillator of its own, restarted each millisecond. With what that may be off (29.5 to 34
 * kHz from -40 to 125 degrees) and a count that is not whole, it resets where a restart comes within
 * 0.41 ms of the last one, and 1.76 ms behind it at the earliest. */
static void start_watchdog(void) {
    IWDG->KR = 0xCCCC;
    IWDG->KR = 0x5555;
    IWDG->RLR = 15;
    while (IWDG->SR != 0) {
    }
    IWDG->WINR = 12; /* which restarts it, as it is taken over */
    while (IWDG->SR != 0) {
    }
}

static void start_interrupts(void) { /* of one priority, as they are from reset */
    NVIC_ISER[0] = BIT(21) | BIT(28);           /* FDCAN1, TIM2 */
    NVIC_ISER[1] = BIT(50 - 32) | BIT(56 - 32); /* TIM5, DMA2 channel 1 */
    SYSTICK[1] = 1000 * MHZ - 1;
    SYSTICK[2] = 0;
    /* A scan begins in the middle between two ticks: a tick's round of the main loop is over as it
     * has been made. */
    TIM6->CNT = 500;
    TIM6->CR1 = BIT(0);
    SYSTICK[0] = 7;
}

int main(void) {
    start_clocks();
    start_pins();
    start_timers();
    start_converters();
    start_can();
    board_power_on();
    start_watchdog();
    start_interrupts();
    for (;;) {
        hal_lock(); /* an interrupt ends the wait, and is served behind it */
        if (!is_due) {
            __asm volatile("wfi");
        }
        hal_unlock();
        if (is_due) {
            is_due = false;
            board_poll();
        }
    }
}
