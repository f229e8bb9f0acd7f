#include "e2e.h"

enum {
    WINDOW = 0x3FF,   /* ten frames are remembered */
    OKS_TO_ENTER = 3, /* good ones of them to become valid */
    OKS_TO_STAY = 1,
    MOST_ERRORS = 2,
    MOST_DELTA = 2, /* one lost frame is none */
    SILENCE_US = 50000
};

enum finding { SILENT, FEW, ENOUGH, BAD };

static const uint8_t NEXT[4][4] = {
    [E2E_NO_DATA] = {E2E_NO_DATA, E2E_INIT, E2E_VALID, E2E_INVALID},
    [E2E_INIT] = {E2E_INIT, E2E_INIT, E2E_VALID, E2E_INVALID},
    [E2E_VALID] = {E2E_INVALID, E2E_INVALID, E2E_VALID, E2E_INVALID},
    [E2E_INVALID] = {E2E_INVALID, E2E_INVALID, E2E_VALID, E2E_INVALID},
};

/* CRC-16/CCITT-FALSE (polynomial 0x1021), half a byte at a time. */
static uint16_t crc_on(uint16_t crc, uint8_t byte) {
    static const uint16_t TABLE[16] = {
        0x0000, 0x1021, 0x2042, 0x3063, 0x4084, 0x50A5, 0x60C6, 0x70E7,
        0x8108, 0x9129, 0xA14A, 0xB16B, 0xC18C, 0xD1AD, 0xE1CE, 0xF1EF,
    };
    crc = (uint16_t)((crc << 4) ^ TABLE[(crc >> 12) ^ (byte >> 4)]);
    return (uint16_t)((crc << 4) ^ TABLE[(crc >> 12) ^ (byte & 15)]);
}

/* Over everything behind the CRC itself, then the data ID, low byte first. */
static uint16_t crc_of(const uint8_t *data, unsigned length, uint16_t data_id) {
    uint16_t crc = 0xFFFF;
    for (unsigned i = 2; i < length; i++) {
        crc = crc_on(crc, data[i]);
    }
    crc = crc_on(crc, (uint8_t)(data_id & 0xFF));
    return crc_on(crc, (uint8_t)(data_id >> 8));
}

void e2e_protect(uint8_t *data, unsigned length, uint16_t data_id, uint8_t counter) {
    data[2] = counter;
    uint16_t crc = crc_of(data, length, data_id);
    data[0] = (uint8_t)(crc & 0xFF);
    data[1] = (uint8_t)(crc >> 8);
}

enum e2e_status e2e_check(struct e2e_channel *channel, const uint8_t *data, unsigned length,
                          uint16_t data_id) {
    if (crc_of(data, length, data_id) != (data[0] | data[1] << 8)) {
        return E2E_ERROR;
    }
    return e2e_judge(channel, data[2], 256);
}

enum e2e_status e2e_judge(struct e2e_channel *channel, uint8_t counter, unsigned counters) {
    unsigned delta = (counters + counter - channel->counter) % counters;
    bool is_first = !channel->has_counter;
    /* Whatever is said, the next frame is judged against this one: a sender that has restarted is
     * wrong once. */
    channel->counter = counter;
    channel->has_counter = true;
    if (is_first || (delta > 0 && delta <= MOST_DELTA)) {
        return E2E_OK;
    }
    return delta == 0 ? E2E_REPEATED : E2E_WRONG_SEQUENCE;
}

static unsigned ones(uint16_t bits) {
    unsigned count = 0;
    for (; bits != 0; bits &= (uint16_t)(bits - 1)) {
        count++;
    }
    return count;
}

static enum finding find(struct e2e_channel *channel, enum e2e_status status) {
    /* Garbage before anything was ever readable tells nothing of a sender. */
    if (status == E2E_NO_NEW_DATA || (status == E2E_ERROR && channel->state == E2E_NO_DATA)) {
        return SILENT;
    }
    channel->oks = (uint16_t)((channel->oks << 1 | (status == E2E_OK)) & WINDOW);
    channel->errors = (uint16_t)((channel->errors << 1 | (status != E2E_OK)) & WINDOW);
    if (ones(channel->errors) > MOST_ERRORS) {
        return BAD;
    }
    unsigned needed = channel->state == E2E_VALID ? OKS_TO_STAY : OKS_TO_ENTER;
    return ones(channel->oks) >= needed ? ENOUGH : FEW;
}

bool e2e_update(struct e2e_channel *channel, enum e2e_status status, uint32_t own_us) {
    enum finding finding = find(channel, status);
    enum e2e_state next = NEXT[channel->state][finding];
    if (finding == SILENT || (next == E2E_INVALID && channel->state != E2E_INVALID)) {
        channel->oks = 0;
        channel->errors = 0;
    }
    channel->state = next;
    if (status == E2E_OK) {
        channel->is_heard = true;
        channel->heard_us = own_us;
    }
    return status == E2E_OK && next == E2E_VALID;
}

void e2e_watch(struct e2e_channel *channel, uint32_t own_us) {
    if (channel->is_heard && own_us - channel->heard_us >= SILENCE_US) {
        channel->is_heard = false;
        (void)e2e_update(channel, E2E_NO_NEW_DATA, own_us);
    }
}
