/* hal.h for the board NUCLEO-G474RE; docs/bench.md has its pins. Never run on silicon. */
#include "../hal.h"

#include "../board.h"
#include "interrupts.h"
#include "memory.h"
#include "registers.h"

enum {
    LOST_LOOKS = 5, /* at a wheel, two a read: for two reads edges are said to be lost */
    QUEUE = 32      /* frames behind the three of the FDCAN */
};

/* A ring of captured edges. */
struct input {
    uint16_t taken;  /* where the next edge is taken */
    uint16_t end;    /* and where none was as it was looked at, */
    uint32_t end_us; /* by the sensor clock then */
    volatile bool is_overrun;
};

volatile uint16_t edges_low_us[HAL_CHANNELS][RING];
volatile uint16_t scans_raw[HAL_SCANS][TRANSMITTERS];
volatile uint16_t levels_raw[HAL_WHEELS];
volatile bool is_due;
static struct input inputs[HAL_CHANNELS];
static uint8_t lost[HAL_WHEELS];
static volatile bool is_scan;
static volatile bool is_fed = true; /* until the first tick: the watchdog has a window */
static struct frame queue[QUEUE];
static uint32_t queued; /* frames since power-on */
static uint32_t sent;

uint32_t hal_sensor_us(void) {
    return TIM2->CNT;
}

uint32_t hal_own_us(void) {
    return TIM5->CNT;
}

void hal_sync_pulse(void) { /* until the next tick */
    GPIOA->BSRR = BIT(8);
}

void hal_shift_sensor(int32_t by_us) {
    TIM2->CNT += (uint32_t)by_us;
}

/* Looks how far an input's ring is filled. The time is read behind the ring's end: no edge up to
 * there is later. */
static void look(struct input *input, unsigned channel) {
    input->end = (uint16_t)((RING - DMA1->CH[channel].CNDTR) % RING);
    if (input->is_overrun) {
        input->is_overrun = false;
        input->taken = input->end;
        lost[channel / 2] = LOST_LOOKS;
    }
    if (input->taken != input->end) {
        input->end_us = TIM2->CNT;
    }
}

bool hal_next_edge(unsigned channel, uint32_t until_us, uint32_t *stamp_us) {
    struct input *input = &inputs[channel];
    if (input->taken == input->end || input->is_overrun) {
        look(input, channel);
    }
    if (input->taken == input->end) {
        return false;
    }
    /* A stamp has 16 bits, and is less than 65 ms old. */
    *stamp_us = input->end_us - (uint16_t)(input->end_us - edges_low_us[channel][input->taken]);
    if ((int32_t)(until_us - *stamp_us) < 0) {
        return false;
    }
    input->taken = (uint16_t)((input->taken + 1) % RING);
    return true;
}

bool hal_wheel_is_bad(unsigned wheel) {
    lost[wheel] = (uint8_t)(lost[wheel] - (lost[wheel] > 0));
    return lost[wheel] > 0 || transmitter_is_broken(levels_raw[wheel] * 16U);
}

bool hal_scans(struct hal_scan scans[HAL_SCANS]) {
    if (!is_scan) {
        return false;
    }
    is_scan = false;
    for (unsigned i = 0; i < HAL_SCANS; i++) {
        transmitters_scale(scans_raw[HAL_SCANS - 1 - i], &scans[i]);
    }
    return true;
}

static const uint8_t LENGTHS[16] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64};

static void put_element(struct can_element *element, const struct frame *frame) {
    uint32_t code = 0;
    while (LENGTHS[code] < frame->length) {
        code++;
    }
    element->id = frame->id | BIT(30);
    element->dlc = code << 16 | (frame->is_fd ? BIT(21) | BIT(20) : 0);
    for (unsigned i = 0; i < frame->length; i += 4) {
        const uint8_t *from = frame->data + i;
        element->data[i / 4] = from[0] | (uint32_t)from[1] << 8 | (uint32_t)from[2] << 16 |
                               (uint32_t)from[3] << 24;
    }
}

static void get_element(const struct can_element *element, struct frame *frame) {
    uint32_t dlc = element->dlc;
    frame->id = element->id & (BIT(29) - 1);
    frame->is_extended = (element->id & BIT(30)) != 0;
    frame->is_fd = (dlc & BIT(21)) != 0;
    frame->length = LENGTHS[dlc >> 16 & 15];
    for (unsigned i = 0; i < frame->length; i++) {
        frame->data[i] = (uint8_t)(element->data[i / 4] >> 8 * (i % 4));
    }
}

/* With interrupts kept out. */
static void transmit(void) {
    while (sent != queued && !(FDCAN1->TXFQS & BIT(21))) {
        uint32_t place = FDCAN1->TXFQS >> 16 & 3;
        put_element(&FDCAN1_RAM->tx[place], &queue[sent % QUEUE]);
        sent++;
        FDCAN1->TXBAR = BIT(place);
    }
}

void hal_send(const struct frame *frame) {
    hal_lock();
    if (queued - sent < QUEUE) {
        queue[queued % QUEUE] = *frame;
        queued++;
    }
    transmit();
    hal_unlock();
}

bool hal_is_all_sent(void) {
    return sent == queued && FDCAN1->TXBRP == 0;
}

/* A controller that is off the bus comes back by itself once it is let: what waited is old then. */
bool hal_is_bus_off(void) {
    bool is_off = (FDCAN1->PSR & BIT(7)) != 0;
    if (is_off) {
        sent = queued;
        FDCAN1->CCCR &= ~BIT(0);
    }
    return is_off;
}

/* Valves 0 to 6 on PC6 to PC12, 7 and 8 on PB13 and PB14. A bit to set wins over one to clear. */
void hal_drive(uint16_t valves) {
    GPIOC->BSRR = UINT32_C(0x7F) << 22 | (valves & UINT32_C(0x7F)) << 6;
    GPIOB->BSRR = UINT32_C(3) << 29 | (uint32_t)(valves >> 7 & 3) << 13;
}

uint16_t hal_driven(void) {
    return (uint16_t)((GPIOC->IDR >> 6 & 0x7F) | (GPIOB->IDR >> 13 & 3) << 7);
}

void hal_close_clutch(bool close) {
    GPIOB->BSRR = close ? BIT(15) : BIT(31);
}

/* The comparison is with equality: what has passed already is made to come now. */
static void wake(unsigned unit, uint32_t own_us) {
    TIM5->CCR[unit] = own_us;
    TIM5->SR = ~BIT(unit + 1);
    if ((int32_t)(own_us - TIM5->CNT) <= 0) {
        TIM5->EGR = BIT(unit + 1);
    }
}

void hal_wake_at_sensor(uint32_t sensor_us) {
    wake(1, TIM5->CNT + (sensor_us - TIM2->CNT));
}

void hal_wake_at_own(uint32_t own_us) {
    wake(0, own_us);
}

/* Once a tick: a window watchdog takes a refresh that comes early for a fault. */
void hal_watchdog(void) {
    if (!is_fed) {
        is_fed = true;
        IWDG->KR = 0xAAAA;
    }
}

void hal_lock(void) {
    __asm volatile("cpsid i" ::: "memory");
}

void hal_unlock(void) {
    __asm volatile("cpsie i" ::: "memory");
}

/* Half and end of a ring passed within a tick are more than half a ring of edges, of which some may
 * have been written over. */
static void watch_rings(void) {
    uint32_t passed = DMA1->ISR & UINT32_C(0x66666666);
    if (passed == 0) {
        return;
    }
    DMA1->IFCR = passed;
    for (unsigned i = 0; i < HAL_CHANNELS; i++) {
        if ((passed >> 4 * i & 6) == 6) {
            inputs[i].is_overrun = true;
        }
    }
}

void on_tick(void) {
    watch_rings();
    is_due = true;
    is_fed = false;
    GPIOA->BSRR = BIT(8 + 16);
}

void on_scan(void) {
    DMA2->IFCR = BIT(0);
    is_scan = is_due = true;
}

void on_wake(void) {
    TIM5->SR = 0;
    board_on_time();
}

void on_can(void) {
    uint32_t events = FDCAN1->IR;
    struct frame frame;
    FDCAN1->IR = events;
    for (uint32_t status = FDCAN1->RXF0S; (status & 15) != 0; status = FDCAN1->RXF0S) {
        get_element(&FDCAN1_RAM->rx0[status >> 8 & 3], &frame);
        FDCAN1->RXF0A = status >> 8 & 3;
        board_on_frame(&frame);
    }
    if ((events & BIT(19)) != 0) {
        board_on_time();
    }
    transmit();
}

#if IMAGE_TEETH
/* One compare unit toggles its pin as its time has come; frozen again, it does so no second time. */
static uint32_t toggles(unsigned wheel) {
    return FIELD(3, 4 + 8 * (wheel % 2));
}

void hal_toggle_at(unsigned wheel, uint32_t sensor_us) {
    TIM2->CCR[wheel] = sensor_us;
    TIM2->CCMR[wheel / 2] |= toggles(wheel);
    TIM2->SR = ~BIT(wheel + 1);
    TIM2->DIER |= BIT(wheel + 1);
}
#endif

void on_toggle(void) {
#if IMAGE_TEETH
    for (unsigned i = 0; i < HAL_WHEELS; i++) {
        if ((TIM2->SR & TIM2->DIER & BIT(i + 1)) != 0) {
            TIM2->CCMR[i / 2] &= ~toggles(i);
            TIM2->DIER &= ~BIT(i + 1);
            board_on_toggled(i);
        }
    }
#endif
}
