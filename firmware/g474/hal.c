/* hal.h for the board NUCLEO-G474RE; docs/bench.md has its pins. Never run on silicon. */
#include "../hal.h"

#include "../board.h"
#include "interrupts.h"
#include "memory.h"
#include "registers.h"

enum {
    LOST_LOOKS = 5, /* at a wheel, two a read: for two reads edges are said to be lost */
    QUEUE = 32,     /* frames behind the buffers of the FDCAN */
    BUFFERS = 3,
    /* From a scan's beginning to the middle of its four sleeves: two of them, 16 times 37 clocks of
     * 40 MHz each. */
    SLEEVES_US = (2 * 16 * 37 + 20) / 40
};

struct waiting {
    struct frame frame;
    uint32_t since_us; /* own time */
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
volatile uint32_t scanned_us;
static volatile bool is_scan;
static volatile uint32_t sleeves_us; /* of the ten scans that are there */
static volatile bool goes_on = true; /* the main loop; until the first tick it has nothing to do */
static struct waiting queue[QUEUE];
static uint32_t queued; /* frames since power-on */
static uint32_t sent;
static uint32_t since_us[BUFFERS]; /* own time; of what waits in them */
static uint32_t newest_id;         /* of those */
static bool is_cancelling;

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

bool hal_scans(struct hal_scan scans[HAL_SCANS], uint32_t *sampled_us) {
    if (!is_scan) {
        return false;
    }
    is_scan = false;
    *sampled_us = sleeves_us;
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

static bool is_stale(uint32_t waits_since_us) {
    return TIM5->CNT - waits_since_us > HAL_OLDEST_US;
}

/* Buffers of which one can be taken back send the lowest identifier first: to keep the order, a
 * frame waits until all in them have a lower one. With interrupts kept out. */
static void transmit(void) {
    while (sent != queued && !is_cancelling && !hal_is_bus_off() && !(FDCAN1->TXFQS & BIT(21))) {
        const struct waiting *next = &queue[sent % QUEUE];
        uint32_t place = FDCAN1->TXFQS >> 16 & 3;
        if (FDCAN1->TXBRP != 0 && next->frame.id <= newest_id) {
            return;
        }
        put_element(&FDCAN1_RAM->tx[place], &next->frame);
        since_us[place] = next->since_us;
        newest_id = next->frame.id;
        sent++;
        FDCAN1->TXBAR = BIT(place);
    }
}

void hal_send(const struct frame *frame) {
    hal_lock();
    sent += queued - sent == QUEUE;
    queue[queued % QUEUE].frame = *frame;
    queue[queued % QUEUE].since_us = TIM5->CNT;
    queued++;
    transmit();
    hal_unlock();
}

/* A buffer that was taken back is filled again a millisecond later: a frame that was being sent is
 * over by then, also where the FDCAN says too early that it is. */
static void take_back_stale(void) {
    uint32_t pending = FDCAN1->TXBRP;
    uint32_t stale = 0;
    while (sent != queued && is_stale(queue[sent % QUEUE].since_us)) {
        sent++;
    }
    for (unsigned i = 0; i < BUFFERS; i++) {
        stale |= (pending & BIT(i)) != 0 && is_stale(since_us[i]) ? BIT(i) : 0;
    }
    is_cancelling = stale != 0;
    FDCAN1->TXBCR = stale;
}

/* CCE empties the buffers; the FDCAN waits for 129 idle times by itself once INIT is 0. */
static void come_back(void) {
    sent = queued;
    if ((FDCAN1->CCCR & BIT(0)) != 0) {
        FDCAN1->CCCR |= BIT(1);
        FDCAN1->CCCR &= ~(BIT(0) | BIT(1));
    }
}

void hal_keep_bus(void) {
    hal_lock();
    if (hal_is_bus_off()) {
        come_back();
    } else {
        take_back_stale();
        transmit();
    }
    hal_unlock();
}

bool hal_is_all_sent(void) {
    return sent == queued && FDCAN1->TXBRP == 0;
}

bool hal_is_bus_off(void) {
    return (FDCAN1->PSR & BIT(7)) != 0;
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

void hal_watchdog(void) {
    goes_on = true;
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

/* The watchdog has a window: it is restarted by the tick, which nothing holds up but one interrupt
 * or one stretch of the main loop with interrupts kept out, 0.1 ms at most. */
void on_tick(void) {
    if (goes_on) {
        goes_on = false;
        IWDG->KR = 0xAAAA;
    }
    watch_rings();
    is_due = true;
    GPIOA->BSRR = BIT(8 + 16);
}

void on_scan(void) {
    DMA2->IFCR = BIT(0);
    sleeves_us = scanned_us + SLEEVES_US;
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
