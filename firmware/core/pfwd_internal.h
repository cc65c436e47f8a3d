/* What the parts of the core need of each other. */
#ifndef PFWD_INTERNAL_H
#define PFWD_INTERNAL_H

#include "pfwd.h"

/* Faults that the tests of conformance plant; 0 in every real instrument. */
#ifndef PFWD_FAULT
#define PFWD_FAULT 0
#endif
#define PFWD_PLANTED(number) (PFWD_FAULT == (number))

enum {
    PFWD_HELLO = 0x01,
    PFWD_CONFIGURE = 0x02,
    PFWD_START = 0x03,
    PFWD_STOP = 0x04,
    PFWD_SHUNT = 0x05,
    PFWD_ARM = 0x06,
    PFWD_FETCH = 0x07,
    PFWD_ACKNOWLEDGE = 0x08,
    PFWD_RESEND = 0x09,
    PFWD_CALIBRATE = 0x0A,
    PFWD_IDENTITY = 0x81,
    PFWD_SAMPLES = 0x82,
    PFWD_STATUS = 0x83,
    PFWD_EVENT = 0x84,
    PFWD_REFUSAL = 0x85,
    PFWD_ARMED = 0x86,
    PFWD_OFFER = 0x87,
    PFWD_BLOCK = 0x88,
    PFWD_RELEASED = 0x89,
    PFWD_GONE = 0x8A
};

enum {
    PFWD_REFUSE_VERSION = 1,
    PFWD_REFUSE_UNKNOWN = 2,
    PFWD_REFUSE_ARGUMENT = 3,
    PFWD_REFUSE_BUSY = 4,
    PFWD_REFUSE_FAULT = 5
};
enum { PFWD_EVENT_BOOT = 1, PFWD_EVENT_TRIGGER = 2, PFWD_EVENT_SHUNT_ON = 5, PFWD_EVENT_SHUNT_OFF = 6 };

#define PFWD_DROP_SHUNT 1u
#define PFWD_DROP_OPERATOR 2u
#define PFWD_DROP_EARLIER 4u

#define PFWD_NO_CLOCK UINT64_MAX
#define PFWD_CRC_RESIDUE 0x2144DF1Cu /* of any bytes followed by their CRC */

/* pfwd_bytes.c */
uint32_t pfwd_crc(uint32_t crc, const uint8_t *data, size_t size); /* start with 0 */
uint8_t *pfwd_put(uint8_t *at, uint64_t value, unsigned size);
uint64_t pfwd_get(const uint8_t *at, unsigned size);
uint8_t *pfwd_put_text(uint8_t *at, const char *text, size_t most);
uint8_t *pfwd_put_double(uint8_t *at, double value);
uint8_t *pfwd_put_positive(uint8_t *at, double value); /* NaN when it is negative */
uint64_t pfwd_whole_as_f64(uint32_t value);            /* bits */
uint32_t pfwd_milli_as_f32(int32_t value);             /* bits of value / 1000 */
bool pfwd_f64_as_milli(uint64_t bits, uint64_t *milli); /* false: NaN, 0, negative or too large */
void pfwd_put_count(uint8_t *at, int32_t value);
int32_t pfwd_get_count(const uint8_t *at);
void pfwd_copy_bytes(uint8_t *to, const uint8_t *from, size_t size);

/* pfwd_frame.c */
uint32_t pfwd_frame(uint8_t *frame, uint8_t *packet, uint32_t payload, uint8_t type, uint16_t counter);
void pfwd_deframer_reset(pfwd_deframer *in);
/* Take one byte; true: a packet is complete, `kept` and `size` hold it until the next byte. */
bool pfwd_deframe(pfwd_deframer *in, uint8_t byte);

/* pfwd_ring.c */
void pfwd_ring_begin_run(pfwd_instrument *self);
void pfwd_ring_add(pfwd_instrument *self, const int32_t *values);
void pfwd_ring_skip(pfwd_instrument *self, uint32_t lost);
/* Copy counts of samples as they travel, up to `count`; how many were there. */
uint32_t pfwd_ring_copy(const pfwd_instrument *self, uint64_t first, uint32_t count, uint8_t *to);
uint64_t pfwd_ring_clock(const pfwd_instrument *self, uint64_t index);
bool pfwd_ring_shunt(const pfwd_instrument *self, uint64_t index);
uint64_t pfwd_ring_switch(const pfwd_instrument *self, uint64_t index, uint64_t end);

/* pfwd_trigger.c */
void pfwd_trigger_begin_run(pfwd_instrument *self);
void pfwd_trigger_sample(pfwd_instrument *self, int32_t value, uint64_t index);

/* pfwd_calibration.c */
#define PFWD_SETTINGS_BYTES 64u
#define PFWD_CALIBRATION_AT PFWD_SETTINGS_BYTES
typedef enum {
    PFWD_STORE_DONE,
    PFWD_STORE_DAMAGED,
    PFWD_STORE_ARGUMENT,
    PFWD_STORE_BUSY,
    PFWD_STORE_FAULT
} pfwd_stored;
void pfwd_calibration_begin(pfwd_instrument *self);
pfwd_stored pfwd_calibration_store(pfwd_instrument *self, const uint8_t *payload, uint32_t size);
/* As they travel, from the sensitivity to the day on which it expires; NULL: those compiled. */
const uint8_t *pfwd_calibration_values(const pfwd_instrument *self, uint32_t channel);
/* Length and text, NULL: the one compiled. */
const uint8_t *pfwd_calibration_serial(const pfwd_instrument *self);

/* pfwd_drops.c */
bool pfwd_drops_begin(pfwd_instrument *self);
void pfwd_drops_work(pfwd_instrument *self);
/* Discard the drop whose samples are still being taken, if there is one, and count it as lost. */
void pfwd_drops_abandon(pfwd_instrument *self);
void pfwd_drops_keep_settings(pfwd_instrument *self);
/* Slot of a drop, PFWD_MOST_SLOTS when there is none of this name. */
uint32_t pfwd_drops_find(const pfwd_instrument *self, uint32_t stream, uint64_t first);
/* Slot of the drop to offer after so many Offers since Hello or since the oldest was let go of: the
 * oldest, later each in turn; PFWD_MOST_SLOTS when none waits. */
uint32_t pfwd_drops_to_offer(const pfwd_instrument *self, uint32_t offers);
void pfwd_drops_release(pfwd_instrument *self, uint32_t slot);
uint32_t pfwd_drops_block_samples(const pfwd_instrument *self);
/* Bytes of a block, read to `to`. */
uint32_t pfwd_drops_block(const pfwd_instrument *self, uint32_t slot, uint32_t block, uint8_t *to);

#endif
