#include "edges.h"

enum { LONG_US = 0xFFFF }; /* the longest interval that 16 bits tell */

void edges_power_on(struct edge_channel *channel, uint32_t now_us) {
    for (unsigned i = 0; i < EDGE_STAMPS; i++) {
        channel->low_us[i] = 0;
    }
    channel->newest = 0;
    channel->valid = 0;
    channel->index = 0;
    channel->newest_us = now_us;
    channel->long_gaps = 0;
    channel->is_idle = false;
}

void edges_watch(struct edge_channel *channel, uint32_t now_us) {
    if (now_us - channel->newest_us > LONG_US) {
        channel->is_idle = true;
    }
}

void edges_capture(struct edge_channel *channel, uint32_t stamp_us) {
    edges_watch(channel, stamp_us);
    channel->long_gaps = channel->long_gaps << 1 | channel->is_idle;
    channel->is_idle = false;
    channel->newest_us = stamp_us;
    channel->newest = (uint8_t)((channel->newest + 1) % EDGE_STAMPS);
    channel->low_us[channel->newest] = (uint16_t)(stamp_us & 0xFFFF);
    channel->index = (uint16_t)(channel->index + 1);
    if (channel->valid < EDGE_STAMPS) {
        channel->valid++;
    }
}

void edges_read(struct edge_channel *channel, uint32_t now_us, struct edge_read *read) {
    edges_watch(channel, now_us);
    /* Between n edges are n - 1 intervals; the one before the oldest edge is not in the array. */
    uint32_t inside = channel->valid == 0 ? 0 : (UINT32_C(1) << (channel->valid - 1)) - 1;
    read->read_us = now_us;
    read->newest_index = channel->index;
    read->valid_stamps = channel->valid;
    read->long_interval = (channel->long_gaps & inside) != 0;
    read->stopped = channel->is_idle;
    read->sensor_fault = false;
    for (unsigned i = 0; i < EDGE_STAMPS; i++) {
        unsigned place = (channel->newest + EDGE_STAMPS - i) % EDGE_STAMPS;
        read->stamps_us[i] = i < channel->valid ? channel->low_us[place] : 0;
    }
}
