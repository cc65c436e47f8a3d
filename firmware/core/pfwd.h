/* The core of an instrument that speaks the PFWD protocol, version 2 (docs/protocol.md).
 *
 * C99 without heap, operating system or floating-point arithmetic. A board gives the functions of
 * `pfwd_board` and memory for the samples, calls `pfwd_begin` once and `pfwd_poll` for ever, at
 * least every millisecond or so. All state is in `pfwd_instrument`; nothing is static. Doubles of
 * an identity are only copied, as IEEE 754 numbers with the lowest byte first.
 */
#ifndef PFWD_H
#define PFWD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define PFWD_MOST_CHANNELS 8u
#define PFWD_NOT_SAID (-1.0) /* of a frequency, damping, shunt, plate or battery: not known */

#ifndef PFWD_MOST_SLOTS
#define PFWD_MOST_SLOTS 16u /* drops that may wait; each costs 64 bytes of memory */
#endif

enum pfwd_role { PFWD_UNUSED = 0, PFWD_LOAD = 1, PFWD_GEOPHONE = 2, PFWD_DISPLACEMENT = 3 };

typedef struct {
    const char *name; /* up to 32 characters */
    uint8_t role;
    double offset;            /* m from the plate centre */
    double sensitivity;       /* V per N, V per m/s or V per m */
    double zero;              /* V at rest */
    double natural_frequency; /* Hz, or PFWD_NOT_SAID */
    double damping;           /* or PFWD_NOT_SAID */
    double shunt;             /* N, or PFWD_NOT_SAID */
    uint32_t calibrated;      /* yyyymmdd, or 0 */
    uint32_t due;
} pfwd_channel;

typedef struct {
    const char *serial_number; /* up to 32 characters each */
    const char *model;
    const char *firmware;
    uint8_t adc_bits;     /* 8 to 24 */
    double adc_range;     /* V */
    double plate_radius;  /* m, or PFWD_NOT_SAID */
    double plate_mass;    /* kg, or PFWD_NOT_SAID */
    uint8_t centre_seat;  /* 0: plate, 1: ground */
    uint8_t channels;     /* 1 to 8 */
    const pfwd_channel *channel;
    const uint32_t *rates; /* Hz, what can be configured; the first after switching on */
    uint8_t rate_count;
    uint8_t shunt_channel;
    int32_t shunt_counts; /* what the shunt adds to that channel; 0: there is no shunt */
    bool streams;         /* the link can carry samples as they are taken */
    uint32_t drop_samples; /* of the longest drop that is kept; 0: none is */
    bool other_speed;     /* a simulation that runs faster or slower than real time */
} pfwd_identity;

typedef struct {
    int32_t battery_mv;     /* negative: not known */
    int32_t temperature_mc; /* thousandths of a degree Celsius */
    bool temperature_known;
} pfwd_health;

/* What a board does. `context` is what was given to `pfwd_begin`. */
typedef struct {
    /* Bytes out: take what there is room for, return how many that were. Never wait. */
    size_t (*write)(void *context, const uint8_t *data, size_t size);
    /* Bytes in: what has come, up to `size`. Never wait. */
    size_t (*read)(void *context, uint8_t *data, size_t size);
    /* Microseconds since switching on, never back. */
    uint64_t (*time_us)(void *context);
    /* Let the converter run at this rate (Hz), all channels at the same moments; 0: stop it. */
    void (*sample)(void *context, uint32_t rate);
    /* Up to `sets` sets of samples (all channels of one moment) that have come since; `lost`: sets
     * thrown away before these. */
    size_t (*samples)(void *context, int32_t *values, size_t sets, uint32_t *lost);
    /* Switch the calibration shunt; samples that come from now on have it. May be NULL. */
    void (*shunt)(void *context, bool on);
    /* 32 random bits, another number after each reset. */
    uint32_t (*random)(void *context);
    /* Memory that lasts over a reset, for drops and settings. NULL: a part of the memory for
     * samples is taken, and drops are gone after a reset. */
    bool (*store_read)(void *context, uint32_t at, uint8_t *data, size_t size);
    bool (*store_write)(void *context, uint32_t at, const uint8_t *data, size_t size);
    uint32_t store_size;
    /* Battery and temperature. May be NULL. */
    void (*health)(void *context, pfwd_health *health);
} pfwd_board;

/* ---- What follows is the core's own. ---- */

#define PFWD_PAYLOAD_MAX 1024u
#define PFWD_CALIBRATION_BYTES 448u
#define PFWD_PACKET_MAX (PFWD_PAYLOAD_MAX + 7u)
#define PFWD_FRAME_MAX (PFWD_PACKET_MAX + PFWD_PACKET_MAX / 254u + 2u)
#define PFWD_KEPT_BYTES 96u /* of a message from the host; what follows is a newer version's */

typedef struct {
    uint32_t crc;
    uint32_t size;    /* decoded bytes */
    uint32_t encoded; /* bytes since the last zero */
    uint8_t left;     /* bytes of the current run that are still to come */
    bool zero_due;
    bool bad;
    uint8_t kept[PFWD_KEPT_BYTES];
} pfwd_deframer;

typedef struct {
    bool on;
    uint8_t channel;
    uint32_t threshold;
    uint16_t confirm;
    uint32_t before;
    uint32_t after;
    uint32_t hold_off;
} pfwd_trigger_settings;

typedef struct {
    int64_t rest;     /* counts times 65536 */
    int64_t sum;      /* of the samples that rest is learnt from */
    uint32_t learnt;
    uint32_t off_rest; /* samples since it was at rest last */
    bool candidate;    /* beyond the threshold since `candidate_at` */
    bool confirmed;
    uint64_t candidate_at;
    uint32_t candidate_peak;
    uint32_t stayed;
    bool released; /* back at rest since the last drop */
    uint32_t calm; /* samples back at rest */
    bool any;      /* there was a drop in this run */
    uint64_t last_trigger;
    uint64_t last_pulse; /* trigger of the last drop or of the last bounce after it */
    uint32_t last_peak;  /* of that pulse */
} pfwd_trigger_state;

typedef struct {
    uint32_t stream;
    uint64_t first;
    uint64_t clock;
    uint32_t trigger;
    uint32_t samples;
    uint32_t crc;
    uint32_t rate;
    uint32_t order;
    uint8_t channels;
    uint8_t flags;
    bool used;
} pfwd_slot;

typedef struct {
    bool active;
    uint64_t trigger;
    uint32_t before;
    uint32_t after;
    bool by_operator;
} pfwd_hand;

typedef struct {
    bool active;
    uint32_t slot;
    uint32_t done;
    pfwd_slot drop;
} pfwd_copy;

typedef struct {
    uint64_t first;
    uint64_t end;
} pfwd_range;

typedef struct {
    uint32_t stream;
    uint64_t first;
    uint32_t count;
    uint16_t code; /* of a refusal, or kind of an event */
    uint8_t type;
    const char *text;
    uint64_t clock;
} pfwd_answer;

#define PFWD_ANSWERS 16u
#define PFWD_RANGES 8u
#define PFWD_SWITCHES 8u

typedef struct {
    const pfwd_board *board;
    void *context;
    const pfwd_identity *identity;
    uint8_t *memory;
    uint32_t memory_size;

    bool greeted; /* false: nobody has said Hello yet */
    uint32_t rate;
    uint16_t counter;

    pfwd_deframer in;
    uint8_t packet[PFWD_PACKET_MAX];
    uint8_t frame[PFWD_FRAME_MAX];
    uint32_t frame_size;
    uint32_t frame_sent;

    pfwd_answer answers[PFWD_ANSWERS];
    uint32_t answers_first;
    uint32_t answers_count;
    bool identity_due;
    bool armed_due;
    bool status_due;
    bool offer_due;
    uint32_t offers; /* since Hello, or since the oldest drop was let go of */
    uint64_t status_at;
    bool turn;

    bool running; /* the converter */
    bool sending; /* samples are sent as they come */
    uint32_t stream;
    uint64_t next;      /* index of the next sample */
    uint64_t oldest;    /* of those in the ring */
    uint64_t send_next; /* to be sent as it comes */
    uint64_t sent_at;
    uint64_t anchor_index;
    uint64_t anchor_us;
    uint64_t overruns;
    uint32_t ring_samples;

    pfwd_range ranges[PFWD_RANGES];
    uint32_t range_count;

    bool shunt;
    uint64_t shunt_until;
    uint64_t switch_index[PFWD_SWITCHES]; /* where the shunt changed within the run */
    bool switch_on[PFWD_SWITCHES];
    uint32_t switches;

    pfwd_trigger_settings trigger;
    pfwd_trigger_state state;
    pfwd_hand hand;
    pfwd_copy copy;
    bool button;

    pfwd_slot slots[PFWD_MOST_SLOTS];
    uint32_t slot_count;
    uint32_t slot_bytes;
    uint32_t drop_samples;
    uint32_t drops_lost;
    uint32_t order;
    bool lasting;
    uint32_t slots_at; /* in the store, behind settings and calibration */

    bool keeps_calibration;
    uint8_t calibration[PFWD_CALIBRATION_BYTES]; /* the page of the store that holds */

    bool fetching;
    uint32_t fetch_slot;
    uint32_t fetch_next;
    uint32_t fetch_end;
} pfwd_instrument;

/* Begin after switching on. `memory` holds the samples (and the drops, without a store of the
 * board's); both pointers have to stay valid. Returns false when the memory is too small. */
bool pfwd_begin(pfwd_instrument *self, const pfwd_board *board, void *context,
                const pfwd_identity *identity, uint8_t *memory, uint32_t memory_size);

/* Do what is due; call it for ever. */
void pfwd_poll(pfwd_instrument *self);

/* The link was made anew: what was half sent is of no use to whoever listens now. */
void pfwd_link_opened(pfwd_instrument *self);

/* The operator pressed the button: a drop is kept from here, or recorded by the host. */
void pfwd_button(pfwd_instrument *self);

/* Say an Event of this kind. */
void pfwd_say_event(pfwd_instrument *self, uint16_t kind);

/* How many drops wait to be acknowledged. */
uint32_t pfwd_drops_waiting(const pfwd_instrument *self);

#endif
