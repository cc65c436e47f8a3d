/* Finds drops in the counts of the load, in whole numbers. */
#include "pfwd_internal.h"

#define LEARNT_FROM 64u
#define FOLLOWS 1024 /* rest goes this part of the way to each sample */
#define ONE 65536    /* counts are kept in parts of this */

void pfwd_trigger_begin_run(pfwd_instrument *self)
{
    pfwd_trigger_state *state = &self->state;
    state->rest = 0;
    state->sum = 0;
    state->learnt = 0;
    state->off_rest = 0;
    state->candidate = false;
    state->confirmed = false;
    state->candidate_at = 0;
    state->stayed = 0;
    state->released = true;
    state->calm = 0;
    state->any = false;
    state->last_trigger = 0;
    state->last_peak = 0;
    self->hand.active = false;
}

static void learn(pfwd_trigger_state *state, int32_t value)
{
    state->sum += value;
    state->learnt++;
    if (state->learnt == LEARNT_FROM) {
        state->rest = state->sum * (ONE / (int64_t)LEARNT_FROM);
    }
}

static void learn_anew(pfwd_trigger_state *state)
{
    state->sum = 0;
    state->learnt = 0;
    state->off_rest = 0;
    state->candidate = false;
    state->released = true;
}

static void found(pfwd_instrument *self, uint64_t index, bool by_operator)
{
    self->hand.active = true;
    self->hand.trigger = index;
    self->hand.before = self->trigger.before;
    self->hand.after = self->trigger.after;
    self->hand.by_operator = by_operator;
    self->state.candidate = false;
    self->state.released = false;
    self->state.calm = 0;
    self->state.any = true;
    self->state.last_trigger = index;
    self->state.last_peak = 0;
}

void pfwd_trigger_sample(pfwd_instrument *self, int32_t value, uint64_t index)
{
    pfwd_trigger_state *state = &self->state;
    const pfwd_trigger_settings *set = &self->trigger;
    if (self->button && !self->hand.active && set->on) {
        self->button = false;
        found(self, index, true);
    }
    if (state->learnt < LEARNT_FROM) {
        learn(state, value);
        return;
    }
    const int64_t apart = (int64_t)value * ONE - state->rest;
    const uint64_t size = (uint64_t)(apart < 0 ? -apart : apart) / ONE;
    const uint32_t away = (uint32_t)size;
    const bool beyond_half = away > set->threshold / 2u;
    if (self->hand.active) {
        if (away > state->last_peak) {
            state->last_peak = away;
        }
        return;
    }
    if (!set->on) {
        return;
    }
    if (!beyond_half) {
        state->off_rest = 0;
        state->candidate = false;
        state->confirmed = false;
        if (!state->released && ++state->calm >= set->confirm) {
            state->released = true;
        }
        state->rest += apart / FOLLOWS;
        return;
    }
    state->calm = 0;
    if (++state->off_rest >= self->rate) { /* a second: something stands on the plate now */
        learn_anew(state);
        return;
    }
    if (!state->released) {
        return;
    }
    if (!state->candidate) {
        if (away <= set->threshold) {
            return;
        }
        state->candidate = true;
        state->confirmed = false;
        state->candidate_at = index;
        state->stayed = 0;
    }
    if (++state->stayed >= set->confirm) {
        state->confirmed = true;
    }
    const bool held = state->any && index - state->last_trigger < set->hold_off;
    if (state->confirmed && (!held || away > state->last_peak)) {
        found(self, state->candidate_at, false);
        state->last_peak = away;
    }
}
