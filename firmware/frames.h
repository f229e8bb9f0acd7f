/* The messages of GearboxIo, bit for bit as dbc/meshpoint.dbc has them. */
#ifndef FRAMES_H
#define FRAMES_H

#include "e2e.h"
#include "hal.h"

#ifndef PROFILE_CLASSIC
#define PROFILE_CLASSIC 0 /* 1: frames of 8 bytes, for a bus without CAN FD */
#endif

enum { EDGE_STAMPS = 27 };

#define ID_EDGES UINT32_C(0x18FF1080) /* of the first channel; the next ones are 0x100 apart */
#define ID_EDGES_STEP UINT32_C(0x100)
#define ID_GEARBOX_SENSORS UINT32_C(0x18FF2080)
#define ID_SLEEVES_MAIN UINT32_C(0x18FF2180)
#define ID_SLEEVES_AUX UINT32_C(0x18FF2280)
#define ID_VALVE_STATUS UINT32_C(0x18FF2380)
#define ID_VALVE_COMMAND UINT32_C(0x0CFF4003)
#define ID_CLUTCH_COMMAND UINT32_C(0x0CFF4103)

enum {
    LENGTH_EDGES = 64,
    LENGTH_GEARBOX_SENSORS = 16,
    LENGTH_SLEEVES = 48,
    LENGTH_VALVE_STATUS = 16,
    LENGTH_VALVE_COMMAND = 48,
    LENGTH_CLUTCH_COMMAND = 8
};

/* What an edge frame says. */
struct edge_read {
    uint32_t read_us;
    uint16_t newest_index;
    uint8_t valid_stamps;
    bool long_interval;
    bool stopped;
    bool sensor_fault;
    uint16_t stamps_us[EDGE_STAMPS]; /* low 16 bits, newest first */
};

/* What ValveStatus says; one bit a valve. */
struct valve_report {
    uint32_t sample_us;
    uint16_t energised;
    uint16_t pending;
    uint16_t refused_count;
    uint16_t expired_count;
};

enum valve_action { OFF_NOW, ON_NOW, OFF_AT, ON_AT };

/* What ValveCommand says of one valve. */
struct valve_order {
    enum valve_action action;
    uint32_t time_us; /* in the sensor clock; of OFF_AT and ON_AT alone */
};

/* The data ID of each message of ours, from its identifier's group number. */
uint16_t frames_data_id(uint32_t id);

/* Judges a frame as one of this message: its format, CRC and counter. */
enum e2e_status frames_check(struct e2e_channel *channel, const struct frame *frame, uint32_t id,
                             unsigned length);

/* Whole frames but for their header. */
void frames_put_edges(struct frame *frame, unsigned channel, const struct edge_read *read);
void frames_put_gearbox_sensors(struct frame *frame, uint32_t sample_us,
                                const struct hal_scan *scan);
/* `first` is the first of the message's two sleeves: 0 in SleevesMain, 2 in SleevesAux. */
void frames_put_sleeves(struct frame *frame, uint32_t sample_us,
                        const struct hal_scan scans[HAL_SCANS], unsigned first, uint8_t faults);
void frames_put_valve_status(struct frame *frame, const struct valve_report *report);

/* The time that each message of the sensor side begins with. */
uint32_t frames_get_time(const struct frame *frame);
/* All but the flags; false where it says more stamps than there are. */
bool frames_get_edges(const struct frame *frame, struct edge_read *read);
void frames_get_valve_command(const struct frame *frame, struct valve_order orders[HAL_VALVES]);
/* False where the action is none of the DBC's. */
bool frames_get_clutch_command(const struct frame *frame, bool *close);

/* What a frame commands now. */
struct command {
    bool has_orders;
    bool has_clutch;
    bool close_clutch;
    struct valve_order orders[HAL_VALVES];
};

/* What the board sends each 10 ms, in this order, and what it obeys, in the build's profile: on
 * CAN FD frames.c, with -DPROFILE_CLASSIC=1 frames_classic.c. */
void frames_power_on(void);
/* Edges as they were read; the rest at `now_us`, the time of the pulse to a second board. */
void frames_send_reads(const struct edge_read reads[HAL_CHANNELS], uint32_t now_us,
                       const struct hal_scan *scan);
void frames_send_valves(const struct valve_report *report);
/* One bit of `faults` a sleeve. */
void frames_send_sleeves(uint32_t sample_us, const struct hal_scan scans[HAL_SCANS],
                         unsigned faults);
void frames_hear(const struct frame *frame, uint32_t own_us, struct command *command);
/* Takes note of silence, each millisecond and before a frame. */
void frames_watch(uint32_t own_us);
/* Commands count anew once three good ones have come. */
void frames_forget(void);

#endif
