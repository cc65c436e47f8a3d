/* The last samples, packed as they travel. */
#include "pfwd_internal.h"

static uint8_t *place(const pfwd_instrument *self, uint64_t index)
{
    const uint32_t at = (uint32_t)(index % self->ring_samples);
    return self->memory + at * 3u * self->identity->channels;
}

void pfwd_ring_begin_run(pfwd_instrument *self)
{
    if (!(PFWD_PLANTED(11) && self->stream != 0)) {
        self->stream = self->board->random(self->context);
    }
    self->next = self->oldest = self->send_next = 0;
    self->anchor_index = 0;
    self->anchor_us = self->board->time_us(self->context);
    self->switches = 0;
    self->range_count = 0;
    if (self->shunt) {
        self->switch_index[0] = 0;
        self->switch_on[0] = true;
        self->switches = 1;
    }
}

void pfwd_ring_add(pfwd_instrument *self, const int32_t *values)
{
    uint8_t *at = place(self, self->next);
    for (uint32_t channel = 0; channel < self->identity->channels; channel++) {
        pfwd_put_count(at, values[channel]);
        at += 3;
    }
    self->next++;
    if (self->next - self->oldest > self->ring_samples) {
        self->oldest = self->next - self->ring_samples;
    }
}

void pfwd_ring_skip(pfwd_instrument *self, uint32_t lost)
{
    /* What the converter took and nobody has: indices go on, and nothing before can be asked for. */
    self->overruns += lost;
    self->next += lost;
    self->oldest = self->next;
}

uint32_t pfwd_ring_copy(const pfwd_instrument *self, uint64_t first, uint32_t count, uint8_t *to)
{
    const uint32_t set = 3u * self->identity->channels;
    if (first < self->oldest || first >= self->next) {
        return 0;
    }
    if (count > self->next - first) {
        count = (uint32_t)(self->next - first);
    }
    for (uint32_t i = 0; i < count; i++) {
        pfwd_copy_bytes(to + i * set, place(self, first + i), set);
    }
    return count;
}

uint64_t pfwd_ring_clock(const pfwd_instrument *self, uint64_t index)
{
    /* Of the newest sample it is known when it came. */
    if (index >= self->anchor_index) {
        return self->anchor_us + (index - self->anchor_index) * 1000000u / self->rate;
    }
    const uint64_t back = (self->anchor_index - index) * 1000000u / self->rate;
    return back < self->anchor_us ? self->anchor_us - back : 0;
}

bool pfwd_ring_shunt(const pfwd_instrument *self, uint64_t index)
{
    bool on = false;
    for (uint32_t i = 0; i < self->switches; i++) {
        if (self->switch_index[i] <= index) {
            on = self->switch_on[i];
        }
    }
    return on;
}

uint64_t pfwd_ring_switch(const pfwd_instrument *self, uint64_t index, uint64_t end)
{
    for (uint32_t i = 0; i < self->switches; i++) {
        if (self->switch_index[i] > index && self->switch_index[i] < end) {
            return self->switch_index[i];
        }
    }
    return end;
}
