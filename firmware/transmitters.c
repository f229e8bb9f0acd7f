#include "transmitters.h"

enum {
    BROKEN_LOW = TRANSMITTER_FULL / 20,
    AT_10 = TRANSMITTER_FULL / 10,
    AT_90 = TRANSMITTER_FULL - AT_10,
    BROKEN_HIGH = TRANSMITTER_FULL - BROKEN_LOW
};

/* A transmitter's value at 10 % of full scale, and how much more it is at 90 %. */
struct range {
    int32_t from;
    int32_t span;
};

static const struct range SLEEVE_UM = {-20000, 40000};
static const struct range PRESSURE_20PA = {0, 50000};
static const struct range OIL_CENTIDEGREE = {4000, 26000};
static const struct range CLUTCH_BASISPOINT = {0, 10000};

bool transmitter_is_broken(uint32_t reading) {
    return reading < BROKEN_LOW || reading > BROKEN_HIGH;
}

/* To the nearest step; by 16 so that it fits into 32 bits. */
static int32_t value(uint16_t reading, const struct range *range) {
    int32_t whole = (AT_90 - AT_10) / 16;
    return range->from + ((reading - AT_10) * (range->span / 16) + whole / 2) / whole;
}

static uint16_t least_value(uint16_t reading, const struct range *range) {
    return (uint16_t)(reading < AT_10 ? range->from : value(reading, range));
}

void transmitters_scale(const volatile uint16_t readings[TRANSMITTERS], struct hal_scan *scan) {
    scan->bad_sleeves = 0;
    for (unsigned i = 0; i < HAL_SLEEVES; i++) {
        scan->sleeve_um[i] = (int16_t)value(readings[i], &SLEEVE_UM);
        scan->bad_sleeves = (uint8_t)(scan->bad_sleeves | transmitter_is_broken(readings[i]) << i);
    }
    scan->brake_20pa = least_value(readings[4], &PRESSURE_20PA);
    scan->supply_20pa = least_value(readings[5], &PRESSURE_20PA);
    scan->oil_centidegree = least_value(readings[6], &OIL_CENTIDEGREE);
    scan->clutch_basispoint = least_value(readings[7], &CLUTCH_BASISPOINT);
}
