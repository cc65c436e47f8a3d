/* Drops that wait until the host has them on its disk.
 *
 * The store begins with a page of settings and two of calibration; then come slots of equal size: a header and the counts
 * as they travel. A header is written last and cleared first, so that a slot whose header is right
 * is whole, whenever the power went.
 */
#include "pfwd_internal.h"

#define SETTINGS_BYTES PFWD_SETTINGS_BYTES
#define HEADER_BYTES 64u
#define MAGIC 0x44574650u    /* "PFWD" */
#define SETTINGS_MAGIC 0x53574650u
#define BLOCK_BYTES 240u
#define COPY_SETS 64u /* in one poll: a store may be slow */
#define PATIENT_OFFERS 8u /* of the oldest alone: what a host cannot record blocks no other */

static bool store_read(const pfwd_instrument *self, uint32_t at, uint8_t *data, size_t size)
{
    if (self->lasting) {
        return self->board->store_read(self->context, at, data, size);
    }
    const uint32_t ring = self->ring_samples * 3u * self->identity->channels;
    pfwd_copy_bytes(data, self->memory + ring + at, size);
    return true;
}

static bool store_write(pfwd_instrument *self, uint32_t at, const uint8_t *data, size_t size)
{
    if (self->lasting) {
        return self->board->store_write(self->context, at, data, size);
    }
    const uint32_t ring = self->ring_samples * 3u * self->identity->channels;
    pfwd_copy_bytes(self->memory + ring + at, data, size);
    return true;
}

static uint32_t slot_at(const pfwd_instrument *self, uint32_t slot)
{
    return self->slots_at + slot * self->slot_bytes;
}

static void put_header(uint8_t *header, const pfwd_slot *drop)
{
    uint8_t *at = pfwd_put(header, MAGIC, 4);
    at = pfwd_put(at, drop->order, 4);
    at = pfwd_put(at, drop->stream, 4);
    at = pfwd_put(at, drop->first, 8);
    at = pfwd_put(at, drop->clock, 8);
    at = pfwd_put(at, drop->trigger, 4);
    at = pfwd_put(at, drop->samples, 4);
    at = pfwd_put(at, drop->crc, 4);
    at = pfwd_put(at, drop->rate, 4);
    at = pfwd_put(at, drop->channels, 1);
    at = pfwd_put(at, drop->flags, 1);
    while (at < header + HEADER_BYTES - 4u) {
        *at++ = 0;
    }
    pfwd_put(at, pfwd_crc(0, header, HEADER_BYTES - 4u), 4);
}

static bool get_header(const uint8_t *header, pfwd_slot *drop)
{
    if (pfwd_crc(0, header, HEADER_BYTES) != PFWD_CRC_RESIDUE || pfwd_get(header, 4) != MAGIC) {
        return false;
    }
    drop->order = (uint32_t)pfwd_get(header + 4, 4);
    drop->stream = (uint32_t)pfwd_get(header + 8, 4);
    drop->first = pfwd_get(header + 12, 8);
    drop->clock = pfwd_get(header + 20, 8);
    drop->trigger = (uint32_t)pfwd_get(header + 28, 4);
    drop->samples = (uint32_t)pfwd_get(header + 32, 4);
    drop->crc = (uint32_t)pfwd_get(header + 36, 4);
    drop->rate = (uint32_t)pfwd_get(header + 40, 4);
    drop->channels = header[44];
    drop->flags = header[45];
    return true;
}

static void recall_settings(pfwd_instrument *self)
{
    uint8_t page[SETTINGS_BYTES];
    if (!store_read(self, 0, page, sizeof page) ||
        pfwd_crc(0, page, sizeof page) != PFWD_CRC_RESIDUE || pfwd_get(page, 4) != SETTINGS_MAGIC) {
        return;
    }
    pfwd_trigger_settings *set = &self->trigger;
    set->on = page[4] != 0;
    set->channel = page[5];
    set->threshold = (uint32_t)pfwd_get(page + 6, 4);
    set->confirm = (uint16_t)pfwd_get(page + 10, 2);
    set->before = (uint32_t)pfwd_get(page + 12, 4);
    set->after = (uint32_t)pfwd_get(page + 16, 4);
    set->hold_off = (uint32_t)pfwd_get(page + 20, 4);
    const uint32_t rate = (uint32_t)pfwd_get(page + 24, 4);
    for (uint32_t i = 0; i < self->identity->rate_count; i++) {
        if (self->identity->rates[i] == rate) {
            self->rate = rate;
        }
    }
    if (set->channel >= self->identity->channels || set->threshold == 0 || set->after == 0 ||
        set->before > self->drop_samples || set->after > self->drop_samples - set->before) {
        set->on = false;
    }
}

void pfwd_drops_keep_settings(pfwd_instrument *self)
{
    if (!self->lasting) {
        return;
    }
    uint8_t page[SETTINGS_BYTES] = {0};
    const pfwd_trigger_settings *set = &self->trigger;
    pfwd_put(page, SETTINGS_MAGIC, 4);
    page[4] = set->on ? 1 : 0;
    page[5] = set->channel;
    pfwd_put(page + 6, set->threshold, 4);
    pfwd_put(page + 10, set->confirm, 2);
    pfwd_put(page + 12, set->before, 4);
    pfwd_put(page + 16, set->after, 4);
    pfwd_put(page + 20, set->hold_off, 4);
    pfwd_put(page + 24, self->rate, 4);
    pfwd_put(page + SETTINGS_BYTES - 4u, pfwd_crc(0, page, SETTINGS_BYTES - 4u), 4);
    (void)store_write(self, 0, page, sizeof page);
}

bool pfwd_drops_begin(pfwd_instrument *self)
{
    const uint32_t set = 3u * self->identity->channels;
    const pfwd_board *board = self->board;
    self->lasting = board->store_read != NULL && board->store_write != NULL && board->store_size > 0;
    uint32_t store = board->store_size;
    uint32_t ring = self->memory_size;
    self->drop_samples = self->identity->drop_samples;
    if (!self->lasting) {
        store = self->drop_samples > 0 ? self->memory_size / 2u : 0;
        ring = self->memory_size - store;
    }
    self->ring_samples = ring / set;
    if (self->ring_samples < 64u) {
        return false;
    }
    /* A drop is copied out of the ring while the ring goes on. */
    if (self->drop_samples > self->ring_samples / 4u * 3u) {
        self->drop_samples = self->ring_samples / 4u * 3u;
    }
    self->keeps_calibration =
        self->lasting && store >= PFWD_CALIBRATION_AT + 2u * PFWD_CALIBRATION_BYTES;
    self->slots_at =
        SETTINGS_BYTES + (self->keeps_calibration ? 2u * PFWD_CALIBRATION_BYTES : 0u);
    self->slot_bytes = HEADER_BYTES + self->drop_samples * set;
    self->slot_count = 0;
    if (self->drop_samples > 0 && store > self->slots_at) {
        self->slot_count = (store - self->slots_at) / self->slot_bytes;
        if (!self->lasting && self->slot_count == 0) { /* as much of one as there is room for */
            self->drop_samples = (store - self->slots_at - HEADER_BYTES) / set;
            self->slot_bytes = HEADER_BYTES + self->drop_samples * set;
            self->slot_count = 1;
        }
    }
    if (self->slot_count > PFWD_MOST_SLOTS) {
        self->slot_count = PFWD_MOST_SLOTS;
    }
    if (self->slot_count == 0) {
        self->drop_samples = 0;
        return true;
    }
    if (!self->lasting) {
        return true;
    }
    recall_settings(self);
    for (uint32_t slot = 0; slot < self->slot_count; slot++) {
        uint8_t header[HEADER_BYTES];
        pfwd_slot *drop = &self->slots[slot];
        if (store_read(self, slot_at(self, slot), header, sizeof header) &&
            get_header(header, drop) && drop->channels == self->identity->channels &&
            drop->samples > 0 && drop->samples <= self->drop_samples &&
            drop->trigger <= drop->samples) {
            drop->used = true;
            drop->flags |= PFWD_DROP_EARLIER;
            if (drop->order >= self->order) {
                self->order = drop->order + 1u;
            }
        }
    }
    return true;
}

uint32_t pfwd_drops_find(const pfwd_instrument *self, uint32_t stream, uint64_t first)
{
    for (uint32_t slot = 0; slot < self->slot_count; slot++) {
        const pfwd_slot *drop = &self->slots[slot];
        if (drop->used && drop->stream == stream && drop->first == first) {
            return slot;
        }
    }
    return PFWD_MOST_SLOTS;
}

/* The drop that follows the one in `last` in time, PFWD_MOST_SLOTS: the oldest of all. */
static uint32_t next_oldest(const pfwd_instrument *self, uint32_t last)
{
    uint32_t found = PFWD_MOST_SLOTS;
    for (uint32_t slot = 0; slot < self->slot_count; slot++) {
        if (self->slots[slot].used &&
            (last == PFWD_MOST_SLOTS || self->slots[slot].order > self->slots[last].order) &&
            (found == PFWD_MOST_SLOTS || self->slots[slot].order < self->slots[found].order)) {
            found = slot;
        }
    }
    return found;
}

uint32_t pfwd_drops_to_offer(const pfwd_instrument *self, uint32_t offers)
{
    const uint32_t waiting = pfwd_drops_waiting(self);
    uint32_t turn = 0;
    if (waiting > 0 && offers >= PATIENT_OFFERS) {
        turn = (offers - PATIENT_OFFERS + 1u) % waiting;
    }
    uint32_t slot = next_oldest(self, PFWD_MOST_SLOTS);
    while (turn > 0) {
        slot = next_oldest(self, slot);
        turn--;
    }
    return slot;
}

uint32_t pfwd_drops_waiting(const pfwd_instrument *self)
{
    uint32_t count = 0;
    for (uint32_t slot = 0; slot < self->slot_count; slot++) {
        count += self->slots[slot].used ? 1u : 0u;
    }
    return count;
}

void pfwd_drops_release(pfwd_instrument *self, uint32_t slot)
{
    if (PFWD_PLANTED(5)) {
        return;
    }
    const uint8_t cleared[4] = {0, 0, 0, 0};
    (void)store_write(self, slot_at(self, slot), cleared, sizeof cleared);
    self->slots[slot].used = false;
    if (self->fetching && self->fetch_slot == slot) {
        self->fetching = false;
    }
}

uint32_t pfwd_drops_block_samples(const pfwd_instrument *self)
{
    return BLOCK_BYTES / (3u * self->identity->channels);
}

uint32_t pfwd_drops_block(const pfwd_instrument *self, uint32_t slot, uint32_t block, uint8_t *to)
{
    const pfwd_slot *drop = &self->slots[slot];
    const uint32_t each = pfwd_drops_block_samples(self);
    const uint32_t first = block * each;
    if (!drop->used || first >= drop->samples) {
        return 0;
    }
    const uint32_t left = drop->samples - first;
    const uint32_t size = (left < each ? left : each) * 3u * drop->channels;
    const uint32_t at = slot_at(self, slot) + HEADER_BYTES + first * 3u * drop->channels;
    return store_read(self, at, to, size) ? size : 0;
}

static void begin_copy(pfwd_instrument *self)
{
    const pfwd_hand *hand = &self->hand;
    uint32_t before = hand->before;
    if (PFWD_PLANTED(17)) {
        before /= 2u;
    }
    uint64_t first = hand->trigger > before ? hand->trigger - before : 0;
    if (first < self->oldest) {
        first = self->oldest;
    }
    uint32_t slot = 0;
    while (slot < self->slot_count && self->slots[slot].used) {
        slot++;
    }
    if (slot >= self->slot_count || hand->trigger < first) {
        self->drops_lost++; /* those that wait are not given up for it */
        return;
    }
    pfwd_copy *copy = &self->copy;
    copy->active = true;
    copy->slot = slot;
    copy->done = 0;
    copy->drop.stream = self->stream;
    copy->drop.first = first;
    copy->drop.clock = pfwd_ring_clock(self, hand->trigger);
    copy->drop.trigger = (uint32_t)(hand->trigger - first);
    copy->drop.samples = (uint32_t)(hand->trigger + hand->after - first);
    copy->drop.crc = 0;
    copy->drop.rate = self->rate;
    copy->drop.order = self->order++;
    copy->drop.channels = self->identity->channels;
    copy->drop.flags = hand->by_operator ? PFWD_DROP_OPERATOR : 0;
    copy->drop.used = true;
}

static void go_on_copying(pfwd_instrument *self)
{
    pfwd_copy *copy = &self->copy;
    const uint32_t set = 3u * self->identity->channels;
    uint8_t data[3u * PFWD_MOST_CHANNELS];
    for (uint32_t i = 0; i < COPY_SETS && copy->done < copy->drop.samples; i++) {
        const uint64_t index = copy->drop.first + copy->done;
        const uint32_t at = slot_at(self, copy->slot) + HEADER_BYTES + copy->done * set;
        if (pfwd_ring_copy(self, index, 1, data) == 0 || !store_write(self, at, data, set)) {
            copy->active = false; /* the ring or the store failed: there is no whole drop */
            self->drops_lost++;
            return;
        }
        copy->drop.crc = pfwd_crc(copy->drop.crc, data, set);
        if (pfwd_ring_shunt(self, index)) {
            copy->drop.flags |= PFWD_DROP_SHUNT;
        }
        copy->done++;
    }
    if (copy->done < copy->drop.samples) {
        return;
    }
    uint8_t header[HEADER_BYTES];
    copy->active = false;
    if (PFWD_PLANTED(6)) {
        copy->drop.crc ^= 0x100u;
    }
    put_header(header, &copy->drop);
    if (!store_write(self, slot_at(self, copy->slot), header, sizeof header)) {
        self->drops_lost++;
        return;
    }
    self->slots[copy->slot] = copy->drop;
    self->offer_due = true;
}

void pfwd_drops_work(pfwd_instrument *self)
{
    if (self->hand.active && !self->copy.active &&
        self->next >= self->hand.trigger + self->hand.after) {
        self->hand.active = false;
        begin_copy(self);
    }
    if (self->copy.active) {
        go_on_copying(self);
    }
}

void pfwd_drops_abandon(pfwd_instrument *self)
{
    if (self->hand.active) {
        self->hand.active = false;
        self->drops_lost++;
    }
}
