/* The calibration that the host has stored, in place of the one that was compiled.
 *
 * Two pages behind that of the settings, each with an order number and a CRC; the older of them is
 * written over. A page that is there by half is not used, and the one before it is still whole.
 */
#include "pfwd_internal.h"

#define MAGIC 0x43574650u /* "PFWC" */
#define ORDER_AT 4u
#define CHANNELS_AT 8u
#define STORED_AT 9u /* a bit for each channel */
#define SERIAL_AT 10u /* length and 32 bytes */
#define VALUES_AT 43u
#define VALUES_BYTES 48u
#define CRC_AT (PFWD_CALIBRATION_BYTES - 4u)
#define LONGEST_SERIAL 32u

static uint32_t page_at(uint32_t order)
{
    return PFWD_CALIBRATION_AT + (order & 1u) * PFWD_CALIBRATION_BYTES;
}

static bool finite_bits(uint64_t bits)
{
    return ((bits >> 52) & 0x7FFu) != 0x7FFu;
}

static bool is_nan(uint64_t bits)
{
    return !finite_bits(bits) && (bits & 0xFFFFFFFFFFFFFu) != 0;
}

static bool is_positive(uint64_t bits)
{
    return (bits >> 63) == 0 && bits != 0 && finite_bits(bits);
}

static bool is_day(uint32_t number)
{
    static const uint8_t days[12] = {31, 29, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31};
    const uint32_t year = number / 10000u;
    const uint32_t month = number / 100u % 100u;
    const uint32_t day = number % 100u;
    if (number == 0) {
        return true; /* not said */
    }
    if (year < 1 || year > 9999u || month < 1 || month > 12u || day < 1 || day > days[month - 1u]) {
        return false;
    }
    return month != 2u || day < 29u || (year % 4u == 0 && (year % 100u != 0 || year % 400u == 0));
}

static bool sound_values(const uint8_t *values)
{
    const uint64_t sensitivity = pfwd_get(values, 8);
    const uint64_t zero = pfwd_get(values + 8, 8);
    const uint64_t frequency = pfwd_get(values + 16, 8);
    const uint64_t damping = pfwd_get(values + 24, 8);
    const uint64_t shunt = pfwd_get(values + 32, 8);
    return finite_bits(sensitivity) && (sensitivity << 1) != 0 && finite_bits(zero) &&
           (is_nan(frequency) ? is_nan(damping) : is_positive(frequency) && is_positive(damping)) &&
           (is_nan(shunt) || is_positive(shunt)) && is_day((uint32_t)pfwd_get(values + 40, 4)) &&
           is_day((uint32_t)pfwd_get(values + 44, 4));
}

static bool sound_serial(const uint8_t *text)
{
    for (uint32_t i = 1; i <= text[0]; i++) {
        if (text[i] < 0x20u || text[i] > 0x7Eu) {
            return false;
        }
    }
    return true;
}

static bool sound_page(const pfwd_instrument *self, const uint8_t *page)
{
    return pfwd_crc(0, page, PFWD_CALIBRATION_BYTES) == PFWD_CRC_RESIDUE &&
           pfwd_get(page, 4) == MAGIC && page[CHANNELS_AT] == self->identity->channels &&
           page[SERIAL_AT] <= LONGEST_SERIAL;
}

void pfwd_calibration_begin(pfwd_instrument *self)
{
    if (!self->keeps_calibration) {
        return;
    }
    for (uint32_t i = 0; i < 2u; i++) {
        uint8_t *page = self->packet;
        if (self->board->store_read(self->context, page_at(i), page, PFWD_CALIBRATION_BYTES) &&
            sound_page(self, page) &&
            (self->calibration[CHANNELS_AT] == 0 || /* there is none so far */
             pfwd_get(page + ORDER_AT, 4) > pfwd_get(self->calibration + ORDER_AT, 4))) {
            pfwd_copy_bytes(self->calibration, page, PFWD_CALIBRATION_BYTES);
        }
    }
}

pfwd_stored pfwd_calibration_store(pfwd_instrument *self, const uint8_t *payload, uint32_t size)
{
    const uint8_t channel = payload[0];
    const uint8_t *serial = payload + 1u + VALUES_BYTES;
    if (size < 2u + VALUES_BYTES + serial[0]) {
        return PFWD_STORE_DAMAGED;
    }
    if (channel >= self->identity->channels || serial[0] > LONGEST_SERIAL ||
        !sound_values(payload + 1) || !sound_serial(serial)) {
        return PFWD_STORE_ARGUMENT;
    }
    const bool falling = self->running && self->state.candidate;
    if ((self->sending || self->shunt || self->hand.active || self->copy.active || falling ||
         pfwd_drops_waiting(self) > 0) &&
        !PFWD_PLANTED(19)) {
        return PFWD_STORE_BUSY; /* what was sampled before would be read by the new values */
    }
    uint8_t *page = self->packet; /* nothing is being made in it while the host is listened to */
    pfwd_copy_bytes(page, self->calibration, PFWD_CALIBRATION_BYTES);
    const uint32_t order = (uint32_t)pfwd_get(page + ORDER_AT, 4) + 1u;
    pfwd_put(page, MAGIC, 4);
    pfwd_put(page + ORDER_AT, order, 4);
    page[CHANNELS_AT] = self->identity->channels;
    page[STORED_AT] = (uint8_t)(page[STORED_AT] | 1u << channel);
    if (serial[0] > 0) {
        pfwd_copy_bytes(page + SERIAL_AT, serial, 1u + serial[0]);
    }
    pfwd_copy_bytes(page + VALUES_AT + channel * VALUES_BYTES, payload + 1, VALUES_BYTES);
    pfwd_put(page + CRC_AT, pfwd_crc(0, page, CRC_AT), 4);
    const uint32_t crc = (uint32_t)pfwd_get(page + CRC_AT, 4);
    if (!self->board->store_write(self->context, page_at(order), page, PFWD_CALIBRATION_BYTES) ||
        !self->board->store_read(self->context, page_at(order), page, PFWD_CALIBRATION_BYTES) ||
        !sound_page(self, page) || pfwd_get(page + CRC_AT, 4) != crc) {
        return PFWD_STORE_FAULT;
    }
    pfwd_copy_bytes(self->calibration, page, PFWD_CALIBRATION_BYTES);
    return PFWD_STORE_DONE;
}

const uint8_t *pfwd_calibration_values(const pfwd_instrument *self, uint32_t channel)
{
    const bool stored = (self->calibration[STORED_AT] >> channel & 1u) != 0;
    return stored ? self->calibration + VALUES_AT + channel * VALUES_BYTES : NULL;
}

const uint8_t *pfwd_calibration_serial(const pfwd_instrument *self)
{
    return self->calibration[SERIAL_AT] > 0 ? self->calibration + SERIAL_AT : NULL;
}
