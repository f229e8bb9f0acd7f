/* End-to-end protection of frames: AUTOSAR E2E profile 5, and the state machine of a channel. */
#ifndef E2E_H
#define E2E_H

#include <stdbool.h>
#include <stdint.h>

enum { E2E_HEADER = 3 }; /* bytes: CRC, low byte first, and counter */

enum e2e_status { E2E_OK, E2E_REPEATED, E2E_WRONG_SEQUENCE, E2E_ERROR, E2E_NO_NEW_DATA };

enum e2e_state { E2E_NO_DATA, E2E_INIT, E2E_VALID, E2E_INVALID };

/* What is known of one message that is received each 10 ms. All zero at power-on. */
struct e2e_channel {
    enum e2e_state state;
    uint16_t oks;    /* the last ten frames, the newest in bit 0: good ones */
    uint16_t errors; /* and bad ones */
    uint8_t counter; /* of the frame before */
    bool has_counter;
    bool is_heard;     /* since the last silence */
    uint32_t heard_us; /* own time of the last good frame */
};

/* Writes the header of a frame of `length` bytes. */
void e2e_protect(uint8_t *data, unsigned length, uint16_t data_id, uint8_t counter);

/* Judges a counter that goes round by `counters` against the one before. */
enum e2e_status e2e_judge(struct e2e_channel *channel, uint8_t counter, unsigned counters);

/* Judges CRC and counter of a frame of the right length. */
enum e2e_status e2e_check(struct e2e_channel *channel, const uint8_t *data, unsigned length,
                          uint16_t data_id);

/* Moves the channel on by what was found of a frame; whether that one may be acted on. */
bool e2e_update(struct e2e_channel *channel, enum e2e_status status, uint32_t own_us);

/* Takes note of 50 ms without a good frame. Called each millisecond, and before a frame. */
void e2e_watch(struct e2e_channel *channel, uint32_t own_us);

#endif
