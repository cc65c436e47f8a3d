/* Finds drops in the counts of the load, in whole numbers. */
#include "pfwd_internal.h"

#define LEARNT_FROM 64u
#define FOLLOWS 1024 /* rest goes this part of the way to each sample */
#define ONE 65536    /* counts are kept in parts of this */

/* A bounce has less than so many tenths of the peak of the pulse before it: two drops from one
   height differ by less than a quarter. */
#define BOUNCE_TENTHS 7u
/* Tenths of a second from pulse to bounce at most: a weight from 1.2 m that keeps 0.7 of its speed
   is in the air for 0.69 s. */
#define FLIGHT_TENTHS 7u

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
    state->candidate_peak = 0;
    state->stayed = 0;
    state->released = true;
    state->calm = 0;
    state->any = false;
    state->last_trigger = 0;
    state->last_pulse = 0;
    state->last_peak = 0;
    pfwd_drops_abandon(self);
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
    self->state.last_pulse = index;
    self->state.last_peak = 0;
}

/* Whether the candidate, by its time and by its peak so far, is a bounce of the last drop. */
static bool bounces(const pfwd_instrument *self)
{
    const pfwd_trigger_state *state = &self->state;
    const uint64_t flight = state->candidate_at - state->last_pulse;
    return state->any && state->candidate_at - state->last_trigger < self->trigger.hold_off &&
           flight * 10u <= (uint64_t)self->rate * FLIGHT_TENTHS &&
           (uint64_t)state->candidate_peak * 10u < (uint64_t)state->last_peak * BOUNCE_TENTHS;
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
        if (state->candidate && state->confirmed) { /* a bounce, and over */
            state->last_pulse = state->candidate_at;
            state->last_peak = state->candidate_peak;
        }
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
        state->candidate_peak = 0;
        state->stayed = 0;
    }
    if (away > state->candidate_peak) {
        state->candidate_peak = away;
    }
    if (++state->stayed >= set->confirm) {
        state->confirmed = true;
    }
    if (state->confirmed && !bounces(self)) {
        found(self, state->candidate_at, false);
        state->last_peak = state->candidate_peak;
    }
}
