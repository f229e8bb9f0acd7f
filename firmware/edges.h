/* The edge array of one channel: what a read of it says of the last 27 edges. */
#ifndef EDGES_H
#define EDGES_H

#include "frames.h"

struct edge_channel {
    uint16_t low_us[EDGE_STAMPS]; /* a ring of stamps, low 16 bits */
    uint8_t newest;               /* where the newest one is */
    uint8_t valid;
    uint16_t index;     /* edges since power-on */
    uint32_t newest_us; /* sensor clock at the newest edge, or at power-on */
    uint32_t long_gaps; /* bit n: before the edge n before the newest nothing came for long */
    bool is_idle;       /* nothing has come for long by now */
};

void edges_power_on(struct edge_channel *channel, uint32_t now_us);

/* Takes an edge; they come in order. */
void edges_capture(struct edge_channel *channel, uint32_t stamp_us);

/* Takes note of the time. Called at least once an hour: a clock of 32 bits wraps while a shaft
 * stands, so that the length of a standstill is to be noted as it comes, not worked out later. */
void edges_watch(struct edge_channel *channel, uint32_t now_us);

/* What the array holds now; no edge was captured later than now. */
void edges_read(struct edge_channel *channel, uint32_t now_us, struct edge_read *read);

#endif
