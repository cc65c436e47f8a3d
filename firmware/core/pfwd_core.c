/* The conversation: what the host says, what is answered, and what is sent when. */
#include "pfwd_internal.h"

#define VERSION 2u
#define STATUS_EVERY_US 400000u
#define SHUNT_US 10000000u
#define LONGEST_WAIT_US 50000u /* samples are not held back longer, however few they are */
#define SAMPLE_BYTES 480u      /* of counts in a frame: an error of the link then costs little */
#define FRAMES_PER_SECOND 200u /* a frame holds 5 ms at most */
#define SETS_AT_ONCE 16u
#define POLL_FRAMES 64u

static void answer(pfwd_instrument *self, pfwd_answer what)
{
    if (self->answers_count >= PFWD_ANSWERS) {
        return; /* the host repeats what is not answered */
    }
    self->answers[(self->answers_first + self->answers_count) % PFWD_ANSWERS] = what;
    self->answers_count++;
}

static void refuse(pfwd_instrument *self, uint16_t code, const char *text)
{
    const pfwd_answer what = {.type = PFWD_REFUSAL, .code = code, .text = text};
    answer(self, what);
}

void pfwd_say_event(pfwd_instrument *self, uint16_t kind)
{
    const pfwd_answer what = {
        .type = PFWD_EVENT, .code = kind, .clock = self->board->time_us(self->context)};
    answer(self, what);
}

void pfwd_button(pfwd_instrument *self)
{
    pfwd_say_event(self, PFWD_EVENT_TRIGGER);
    self->button = self->trigger.on;
}

void pfwd_link_opened(pfwd_instrument *self)
{
    self->frame_sent = self->frame_size = 0;
    self->in.encoded = 0;
    self->range_count = 0;
    self->fetching = false;
}

/* ---- The converter ---- */

static void end_run(pfwd_instrument *self)
{
    if (self->running) {
        self->running = false;
        self->board->sample(self->context, 0);
    }
}

static void begin_run(pfwd_instrument *self)
{
    while (self->copy.active) { /* its samples are about to be written over */
        pfwd_drops_work(self);
    }
    end_run(self);
    pfwd_ring_begin_run(self);
    pfwd_trigger_begin_run(self);
    self->board->sample(self->context, self->rate);
    self->running = true;
}

static void run_as_wanted(pfwd_instrument *self)
{
    const bool wanted = self->sending || self->trigger.on || self->hand.active || self->copy.active;
    if (wanted && !self->running) {
        begin_run(self);
    } else if (!wanted) {
        end_run(self);
    }
}

static void switch_shunt(pfwd_instrument *self, bool on)
{
    if (self->shunt != on) {
        self->shunt = on;
        self->board->shunt(self->context, on);
        if (self->switches == PFWD_SWITCHES) {
            for (uint32_t i = 1; i < PFWD_SWITCHES; i++) {
                self->switch_index[i - 1u] = self->switch_index[i];
                self->switch_on[i - 1u] = self->switch_on[i];
            }
            self->switches--;
        }
        self->switch_index[self->switches] = self->next;
        self->switch_on[self->switches] = on;
        self->switches++;
    }
    self->shunt_until = self->board->time_us(self->context) + SHUNT_US;
    pfwd_say_event(self, on ? PFWD_EVENT_SHUNT_ON : PFWD_EVENT_SHUNT_OFF);
}

static void take_samples(pfwd_instrument *self)
{
    int32_t values[SETS_AT_ONCE * PFWD_MOST_CHANNELS];
    for (uint32_t turn = 0; turn < POLL_FRAMES && self->running; turn++) {
        uint32_t lost = 0;
        const size_t sets = self->board->samples(self->context, values, SETS_AT_ONCE, &lost);
        if (lost > 0) {
            pfwd_ring_skip(self, lost);
            self->send_next = self->next;
        }
        if (sets == 0) {
            break;
        }
        const int32_t shunted = self->shunt ? self->identity->shunt_counts : 0;
        for (size_t i = 0; i < sets; i++) {
            const int32_t *set = values + i * self->identity->channels;
            int32_t value = set[self->trigger.channel];
            if (self->trigger.channel == self->identity->shunt_channel) {
                value -= shunted; /* the shunt is no drop, and a drop under it is one */
            }
            pfwd_trigger_sample(self, value, self->next);
            pfwd_ring_add(self, set);
            if (self->hand.active) {
                pfwd_drops_work(self);
            }
        }
        self->anchor_index = self->next;
        self->anchor_us = self->board->time_us(self->context);
    }
}

/* ---- What the host says ---- */

static void take_hello(pfwd_instrument *self, const uint8_t *payload)
{
    const uint8_t oldest = payload[4];
    const uint8_t newest = payload[5];
    if (payload[0] != 'P' || payload[1] != 'F' || payload[2] != 'W' || payload[3] != 'D') {
        return;
    }
    if (PFWD_PLANTED(13)) {
        self->greeted = true;
        self->identity_due = true;
        return;
    }
    if (newest < VERSION || oldest > VERSION) {
        refuse(self, PFWD_REFUSE_VERSION, "speaks 2");
        return;
    }
    self->greeted = true;
    self->identity_due = true;
    self->offer_due = true;
    self->offers = 0;
    self->fetching = false;
    if (PFWD_PLANTED(18)) {
        self->sending = false;
    }
}

static void take_configure(pfwd_instrument *self, const uint8_t *payload)
{
    uint64_t wanted = 0;
    if (!pfwd_f64_as_milli(pfwd_get(payload, 8), &wanted)) {
        if (PFWD_PLANTED(12)) {
            self->identity_due = true;
            return;
        }
        refuse(self, PFWD_REFUSE_ARGUMENT, "a sampling rate above 0 Hz");
        return;
    }
    if (wanted > 50000000u) {
        refuse(self, PFWD_REFUSE_ARGUMENT, "a sampling rate up to 50000 Hz");
        return;
    }
    uint32_t best = self->identity->rates[0];
    uint64_t apart = UINT64_MAX;
    for (uint32_t i = 0; i < self->identity->rate_count; i++) {
        const uint64_t rate = (uint64_t)self->identity->rates[i] * 1000u;
        const uint64_t away = rate > wanted ? rate - wanted : wanted - rate;
        if (away < apart) {
            apart = away;
            best = self->identity->rates[i];
        }
    }
    if (best != self->rate) {
        if (self->sending) {
            refuse(self, PFWD_REFUSE_BUSY, "stop sampling first");
            return;
        }
        while (self->copy.active) {
            pfwd_drops_work(self);
        }
        end_run(self);
        pfwd_drops_abandon(self);
        self->trigger.on = false; /* its times were told in samples of the other rate */
        self->rate = best;
        pfwd_drops_keep_settings(self);
    }
    self->identity_due = true;
}

static void take_arm(pfwd_instrument *self, const uint8_t *payload)
{
    pfwd_trigger_settings set;
    set.on = payload[0] != 0;
    set.channel = payload[1];
    set.threshold = (uint32_t)pfwd_get(payload + 2, 4);
    set.confirm = (uint16_t)pfwd_get(payload + 6, 2);
    set.before = (uint32_t)pfwd_get(payload + 8, 4);
    set.after = (uint32_t)pfwd_get(payload + 12, 4);
    set.hold_off = (uint32_t)pfwd_get(payload + 16, 4);
    if (set.on && self->drop_samples == 0) {
        refuse(self, PFWD_REFUSE_ARGUMENT, "keeps no drops");
        return;
    }
    if (set.channel >= self->identity->channels || set.threshold == 0 || set.confirm == 0 ||
        set.after == 0) {
        refuse(self, PFWD_REFUSE_ARGUMENT, "channel, threshold, confirm or after");
        return;
    }
    if (set.after > self->drop_samples) {
        set.after = self->drop_samples;
    }
    if (set.before > self->drop_samples - set.after) {
        set.before = self->drop_samples - set.after;
    }
    /* A drop in hand goes on as it began. */
    if (set.channel != self->trigger.channel && self->running) {
        self->state.learnt = 0;
        self->state.sum = 0;
    }
    self->trigger = set;
    pfwd_drops_keep_settings(self);
    self->armed_due = true;
}

static void take_fetch(pfwd_instrument *self, const uint8_t *payload)
{
    const uint32_t slot =
        pfwd_drops_find(self, (uint32_t)pfwd_get(payload, 4), pfwd_get(payload + 4, 8));
    if (slot == PFWD_MOST_SLOTS) {
        refuse(self, PFWD_REFUSE_ARGUMENT, "no such drop");
        return;
    }
    const uint32_t each = pfwd_drops_block_samples(self);
    const uint32_t blocks = (self->slots[slot].samples + each - 1u) / each;
    const uint32_t first = (uint32_t)pfwd_get(payload + 12, 2);
    const uint32_t count = (uint32_t)pfwd_get(payload + 14, 2);
    self->fetching = first < blocks;
    self->fetch_slot = slot;
    self->fetch_next = first;
    self->fetch_end = count == 0 || count > blocks - first ? blocks : first + count;
    if (!self->fetching) {
        refuse(self, PFWD_REFUSE_ARGUMENT, "no such block");
    }
}

static void take_acknowledge(pfwd_instrument *self, const uint8_t *payload)
{
    const pfwd_answer what = {.type = PFWD_RELEASED,
                              .stream = (uint32_t)pfwd_get(payload, 4),
                              .first = pfwd_get(payload + 4, 8)};
    const uint32_t slot = pfwd_drops_find(self, what.stream, what.first);
    if (slot != PFWD_MOST_SLOTS) {
        if (slot == pfwd_drops_to_offer(self, 0)) {
            self->offers = 0;
        }
        pfwd_drops_release(self, slot);
        self->offer_due = true;
    }
    answer(self, what);
}

static void say_gone(pfwd_instrument *self, uint32_t stream, uint64_t first, uint64_t count)
{
    const pfwd_answer what = {
        .type = PFWD_GONE, .stream = stream, .first = first, .count = (uint32_t)count};
    answer(self, what);
}

static void take_resend(pfwd_instrument *self, const uint8_t *payload)
{
    const uint32_t stream = (uint32_t)pfwd_get(payload, 4);
    const uint64_t first = pfwd_get(payload + 4, 8);
    const uint64_t count = pfwd_get(payload + 12, 4);
    if (count == 0 || first > (UINT64_MAX >> 1)) {
        refuse(self, PFWD_REFUSE_ARGUMENT, "no such samples");
        return;
    }
    const uint64_t end = first + count;
    const uint64_t low = first > self->oldest ? first : self->oldest;
    const uint64_t high = end < self->next ? end : self->next;
    if (stream != self->stream || low >= high) {
        say_gone(self, stream, first, count);
        return;
    }
    if (self->range_count >= PFWD_RANGES) {
        refuse(self, PFWD_REFUSE_BUSY, "too much is asked for again");
        return;
    }
    if (first < low) {
        say_gone(self, stream, first, low - first);
    }
    if (high < end) {
        say_gone(self, stream, high, end - high);
    }
    self->ranges[self->range_count].first = low;
    self->ranges[self->range_count].end = high;
    self->range_count++;
}

static void take_start(pfwd_instrument *self)
{
    self->sent_at = self->board->time_us(self->context);
    if (self->trigger.on && self->running) {
        self->send_next = self->next; /* the run goes on: a drop may be in hand */
    } else {
        begin_run(self);
    }
    self->sending = true;
}

static void take_calibrate(pfwd_instrument *self, const uint8_t *payload, uint32_t size)
{
    if (!self->keeps_calibration) {
        refuse(self, PFWD_REFUSE_UNKNOWN, "keeps no calibration");
        return;
    }
    switch (pfwd_calibration_store(self, payload, size)) {
    case PFWD_STORE_DONE: self->identity_due = true; break;
    case PFWD_STORE_ARGUMENT:
        refuse(self, PFWD_REFUSE_ARGUMENT, "channel, a value, a day or the serial number");
        break;
    case PFWD_STORE_BUSY:
        refuse(self, PFWD_REFUSE_BUSY, "stop sampling, switch off the shunt, fetch what waits");
        break;
    case PFWD_STORE_FAULT: refuse(self, PFWD_REFUSE_FAULT, "the store did not take it"); break;
    default: break; /* damaged: not answered at all */
    }
}

static void take_message(pfwd_instrument *self)
{
    static const struct {
        uint8_t type;
        uint8_t size;
    } known[] = {
        {PFWD_HELLO, 6}, {PFWD_CONFIGURE, 8}, {PFWD_START, 0},        {PFWD_STOP, 0},
        {PFWD_SHUNT, 1}, {PFWD_ARM, 20},      {PFWD_FETCH, 16},       {PFWD_ACKNOWLEDGE, 12},
        {PFWD_RESEND, 16},                    {PFWD_CALIBRATE, 50},
    };
    const uint8_t type = self->in.kept[0];
    const uint8_t *payload = self->in.kept + 3;
    const uint32_t size = self->in.size - 7u;
    for (size_t i = 0; i < sizeof known / sizeof known[0]; i++) {
        if (known[i].type == type && (self->greeted || type == PFWD_HELLO)) {
            if (size < known[i].size) {
                return; /* damaged: not answered at all */
            }
            switch (type) {
            case PFWD_HELLO: take_hello(self, payload); break;
            case PFWD_CONFIGURE: take_configure(self, payload); break;
            case PFWD_START:
                if (!self->identity->streams) {
                    refuse(self, PFWD_REFUSE_UNKNOWN, "keeps drops and sends no stream");
                } else {
                    take_start(self);
                }
                break;
            case PFWD_STOP:
                self->sending = false;
                self->status_due = true;
                break;
            case PFWD_SHUNT:
                if (self->identity->shunt_counts == 0 || self->board->shunt == NULL) {
                    refuse(self, PFWD_REFUSE_ARGUMENT, "there is no shunt");
                } else {
                    switch_shunt(self, payload[0] != 0);
                }
                break;
            case PFWD_ARM: take_arm(self, payload); break;
            case PFWD_FETCH: take_fetch(self, payload); break;
            case PFWD_ACKNOWLEDGE: take_acknowledge(self, payload); break;
            case PFWD_CALIBRATE: take_calibrate(self, payload, size); break;
            default: take_resend(self, payload); break;
            }
            return;
        }
    }
    if (!PFWD_PLANTED(9)) {
        refuse(self, PFWD_REFUSE_UNKNOWN, "unknown message");
    }
}

static void listen(pfwd_instrument *self)
{
    uint8_t data[64];
    size_t size;
    do {
        size = self->board->read(self->context, data, sizeof data);
        for (size_t i = 0; i < size; i++) {
            if (pfwd_deframe(&self->in, data[i])) {
                take_message(self);
            }
        }
    } while (size == sizeof data);
}

/* ---- What is sent ---- */

static void send_packet(pfwd_instrument *self, uint8_t type, uint32_t payload)
{
    self->frame_size = pfwd_frame(self->frame, self->packet, payload, type, self->counter);
    self->frame_sent = 0;
    if (!PFWD_PLANTED(15)) {
        self->counter++;
    }
}

static void send_identity(pfwd_instrument *self)
{
    const pfwd_identity *what = self->identity;
    uint8_t *at = self->packet + 3;
    *at++ = VERSION;
    const uint8_t *serial = pfwd_calibration_serial(self);
    if (serial != NULL) {
        pfwd_copy_bytes(at, serial, 1u + serial[0]);
        at += 1u + serial[0];
    } else {
        at = pfwd_put_text(at, what->serial_number, 32);
    }
    at = pfwd_put_text(at, what->model, 32);
    at = pfwd_put_text(at, what->firmware, 32);
    at = pfwd_put(at, pfwd_whole_as_f64(self->rate), 8);
    *at++ = what->adc_bits;
    at = pfwd_put_double(at, what->adc_range);
    at = pfwd_put_positive(at, what->plate_radius);
    at = pfwd_put_positive(at, what->plate_mass);
    *at++ = what->centre_seat;
    *at++ = what->channels;
    for (uint32_t i = 0; i < what->channels; i++) {
        const pfwd_channel *channel = &what->channel[i];
        at = pfwd_put_text(at, channel->name, 32);
        *at++ = channel->role;
        at = pfwd_put_double(at, channel->offset);
        const uint8_t *stored = pfwd_calibration_values(self, i);
        if (stored != NULL) {
            pfwd_copy_bytes(at, stored, 48);
            at += 48;
            continue;
        }
        at = pfwd_put_double(at, channel->sensitivity);
        at = pfwd_put_double(at, channel->zero);
        at = pfwd_put_positive(at, channel->natural_frequency);
        at = pfwd_put_positive(at, channel->damping);
        at = pfwd_put_positive(at, channel->shunt);
        at = pfwd_put(at, channel->calibrated, 4);
        at = pfwd_put(at, channel->due, 4);
    }
    at = pfwd_put(at, self->ring_samples, 4);
    at = pfwd_put(at, self->drop_samples, 4);
    at = pfwd_put(at, self->slot_count, 2);
    *at++ = (uint8_t)((self->lasting ? 1u : 0u) | (what->streams ? 2u : 0u) |
                      (what->other_speed ? 4u : 0u));
    send_packet(self, PFWD_IDENTITY, (uint32_t)(at - self->packet) - 3u);
}

static void send_status(pfwd_instrument *self)
{
    pfwd_health health = {-1, 0, false};
    if (self->board->health != NULL) {
        self->board->health(self->context, &health);
    }
    const uint32_t unknown = 0x7FC00000u;
    uint8_t *at = pfwd_put(self->packet + 3, self->board->time_us(self->context), 8);
    at = pfwd_put(at, health.battery_mv < 0 ? unknown : pfwd_milli_as_f32(health.battery_mv), 4);
    at = pfwd_put(
        at, health.temperature_known ? pfwd_milli_as_f32(health.temperature_mc) : unknown, 4);
    at = pfwd_put(at, self->overruns, 8);
    *at++ = self->sending ? 1 : 0;
    at = pfwd_put(at, pfwd_drops_waiting(self), 2);
    at = pfwd_put(at, self->drops_lost, 4);
    send_packet(self, PFWD_STATUS, (uint32_t)(at - self->packet) - 3u);
}

static void send_answer(pfwd_instrument *self)
{
    const pfwd_answer what = self->answers[self->answers_first];
    self->answers_first = (self->answers_first + 1u) % PFWD_ANSWERS;
    self->answers_count--;
    uint8_t *at = self->packet + 3;
    switch (what.type) {
    case PFWD_REFUSAL:
        at = pfwd_put(at, what.code, 2);
        at = pfwd_put_text(at, what.text, 255);
        break;
    case PFWD_EVENT:
        at = pfwd_put(at, what.code, 2);
        at = pfwd_put(at, what.clock, 8);
        at = pfwd_put_text(at, what.text, 255);
        break;
    default: /* released, gone */
        at = pfwd_put(at, what.stream, 4);
        at = pfwd_put(at, what.first, 8);
        if (what.type == PFWD_GONE) {
            at = pfwd_put(at, what.count, 4);
        }
        break;
    }
    send_packet(self, what.type, (uint32_t)(at - self->packet) - 3u);
}

static void send_armed(pfwd_instrument *self)
{
    const pfwd_trigger_settings *set = &self->trigger;
    uint8_t *at = self->packet + 3;
    *at++ = set->on ? 1 : 0;
    *at++ = set->channel;
    at = pfwd_put(at, set->threshold, 4);
    at = pfwd_put(at, set->confirm, 2);
    at = pfwd_put(at, set->before, 4);
    at = pfwd_put(at, set->after, 4);
    at = pfwd_put(at, set->hold_off, 4);
    send_packet(self, PFWD_ARMED, (uint32_t)(at - self->packet) - 3u);
}

static void send_offer(pfwd_instrument *self, uint32_t slot)
{
    const pfwd_slot *drop = &self->slots[slot];
    const bool earlier = (drop->flags & PFWD_DROP_EARLIER) != 0;
    uint8_t *at = pfwd_put(self->packet + 3, drop->stream, 4);
    at = pfwd_put(at, drop->first, 8);
    at = pfwd_put(at, earlier ? PFWD_NO_CLOCK : drop->clock, 8);
    at = pfwd_put(at, drop->trigger, 4);
    at = pfwd_put(at, drop->samples, 4);
    *at++ = drop->channels;
    *at++ = drop->flags;
    at = pfwd_put(at, pfwd_drops_block_samples(self), 2);
    at = pfwd_put(at, drop->crc, 4);
    at = pfwd_put(at, pfwd_whole_as_f64(drop->rate), 8);
    send_packet(self, PFWD_OFFER, (uint32_t)(at - self->packet) - 3u);
}

static void send_block(pfwd_instrument *self)
{
    const pfwd_slot *drop = &self->slots[self->fetch_slot];
    uint8_t *at = pfwd_put(self->packet + 3, drop->stream, 4);
    at = pfwd_put(at, drop->first, 8);
    at = pfwd_put(at, self->fetch_next + (PFWD_PLANTED(7) ? 1u : 0u), 2);
    const uint32_t size = pfwd_drops_block(self, self->fetch_slot, self->fetch_next, at);
    self->fetch_next++;
    if (self->fetch_next >= self->fetch_end || size == 0) {
        self->fetching = false;
    }
    if (size > 0) {
        send_packet(self, PFWD_BLOCK, (uint32_t)(at - self->packet) - 3u + size);
    }
    if (PFWD_PLANTED(10) && !self->fetching) {
        self->slots[self->fetch_slot].used = false; /* forgets it before it is safe */
    }
}

/* A Samples frame from `first` on, up to `end`; the index behind it. */
static uint64_t send_samples(pfwd_instrument *self, uint64_t first, uint64_t end)
{
    const uint32_t set = 3u * self->identity->channels;
    uint32_t most = SAMPLE_BYTES / set;
    const uint32_t frame = self->rate / FRAMES_PER_SECOND;
    if (frame > 0 && most > frame) {
        most = frame;
    }
    if (end - first > most) {
        end = first + most;
    }
    end = pfwd_ring_switch(self, first, end);
    const bool resent = end <= self->send_next;
    uint64_t clock = pfwd_ring_clock(self, first);
    if (PFWD_PLANTED(14)) {
        clock += clock / 40u;
    }
    uint8_t *at = pfwd_put(self->packet + 3, self->stream, 4);
    at = pfwd_put(at, first + (PFWD_PLANTED(8) && resent ? 1u : 0u), 8);
    at = pfwd_put(at, clock, 8);
    *at++ = pfwd_ring_shunt(self, first) ? 1 : 0;
    *at++ = self->identity->channels;
    uint8_t *count = at;
    at += 2;
    const uint32_t sent = pfwd_ring_copy(self, first, (uint32_t)(end - first), at);
    pfwd_put(count, sent, 2);
    send_packet(self, PFWD_SAMPLES, 24u + sent * set);
    return first + sent;
}

static bool send_resent(pfwd_instrument *self)
{
    while (self->range_count > 0) {
        pfwd_range *range = &self->ranges[0];
        if (range->first < self->oldest) { /* the ring has gone over it meanwhile */
            const uint64_t lost = range->end < self->oldest ? range->end : self->oldest;
            say_gone(self, self->stream, range->first, lost - range->first);
            range->first = lost;
        }
        if (range->first < range->end && range->first < self->next) {
            range->first = send_samples(self, range->first, range->end);
            return true;
        }
        self->range_count--;
        for (uint32_t i = 0; i < self->range_count; i++) {
            self->ranges[i] = self->ranges[i + 1u];
        }
    }
    return false;
}

static bool send_live(pfwd_instrument *self, uint64_t now)
{
    if (!self->sending || !self->running) {
        return false;
    }
    if (self->send_next < self->oldest) { /* the link is too slow: these are thrown away */
        self->overruns += self->oldest - self->send_next;
        self->send_next = self->oldest;
    }
    const uint64_t waiting = self->next - self->send_next;
    const uint32_t frame = self->rate / FRAMES_PER_SECOND;
    const uint32_t fits = SAMPLE_BYTES / (3u * self->identity->channels);
    const uint32_t enough = frame > 0 && frame < fits ? frame : fits;
    if (waiting == 0 || (waiting < enough && now - self->sent_at < LONGEST_WAIT_US)) {
        return false;
    }
    self->sent_at = now;
    const uint64_t first = self->send_next;
    if (PFWD_PLANTED(2) && first > 0 && first % 1000u < enough) {
        (void)send_samples(self, first - 1u, self->next);
        self->send_next = first + enough - 1u;
        return true;
    }
    self->send_next = self->next; /* what is sent now is no repetition */
    self->send_next = send_samples(self, first, self->next);
    return true;
}

/* Prepare the next frame; false: there is nothing to say. */
static bool say_next(pfwd_instrument *self, uint64_t now)
{
    self->frame_size = self->frame_sent = 0;
    if (!self->greeted) {
        self->status_due = false;
        if (self->answers_count == 0) {
            return false;
        }
        send_answer(self);
        return true;
    }
    if (self->identity_due) {
        self->identity_due = false;
        send_identity(self);
        return true;
    }
    if (self->answers_count > 0) {
        send_answer(self);
        return true;
    }
    if (self->armed_due) {
        self->armed_due = false;
        send_armed(self);
        return true;
    }
    if (self->status_due) {
        self->status_due = false;
        send_status(self);
        return true;
    }
    if (self->offer_due) {
        self->offer_due = false;
        const uint32_t slot = pfwd_drops_to_offer(self, self->offers);
        if (slot != PFWD_MOST_SLOTS && !self->fetching) {
            self->offers++;
            send_offer(self, slot);
            return true;
        }
    }
    /* What is asked for and what comes by itself take turns. */
    self->turn = !self->turn;
    if (self->turn && send_live(self, now)) {
        return true;
    }
    if (send_resent(self)) {
        return true;
    }
    if (self->fetching) {
        send_block(self);
        return self->frame_size > 0;
    }
    return send_live(self, now);
}

static void speak(pfwd_instrument *self, uint64_t now)
{
    for (uint32_t turn = 0; turn < POLL_FRAMES; turn++) {
        if (self->frame_sent < self->frame_size) {
            self->frame_sent += (uint32_t)self->board->write(
                self->context, self->frame + self->frame_sent, self->frame_size - self->frame_sent);
            if (self->frame_sent < self->frame_size) {
                return;
            }
        }
        if (!say_next(self, now)) {
            return;
        }
    }
}

bool pfwd_begin(pfwd_instrument *self, const pfwd_board *board, void *context,
                const pfwd_identity *identity, uint8_t *memory, uint32_t memory_size)
{
    uint8_t *byte = (uint8_t *)self;
    for (size_t i = 0; i < sizeof *self; i++) {
        byte[i] = 0;
    }
    self->board = board;
    self->context = context;
    self->identity = identity;
    self->memory = memory;
    self->memory_size = memory_size;
    self->rate = identity->rates[0];
    pfwd_deframer_reset(&self->in);
    if (identity->channels == 0 || identity->channels > PFWD_MOST_CHANNELS ||
        !pfwd_drops_begin(self)) {
        return false;
    }
    pfwd_calibration_begin(self);
    pfwd_say_event(self, PFWD_EVENT_BOOT);
    self->status_at = board->time_us(context);
    return true;
}

void pfwd_poll(pfwd_instrument *self)
{
    const uint64_t now = self->board->time_us(self->context);
    const uint64_t every = PFWD_PLANTED(4) ? 5u * STATUS_EVERY_US : STATUS_EVERY_US;
    listen(self);
    run_as_wanted(self);
    take_samples(self);
    pfwd_drops_work(self);
    if (self->shunt && now >= self->shunt_until && !PFWD_PLANTED(3)) {
        switch_shunt(self, false);
    }
    if (now - self->status_at >= every) {
        self->status_at = now;
        self->status_due = true;
        self->offer_due = true;
    }
    speak(self, now);
}
