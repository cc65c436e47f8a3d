/* The core driven step by step, for tests and fuzzing: no link, no clock but those it is told.
 *
 * Steps come as records: one letter, a length (u16), that many bytes. After each the program says
 * what the core wrote: a length (u32) and the bytes. With PFWD_LIBFUZZER it is a target of libFuzzer.
 *
 *   B bytes     the host sent these
 *   T u32       so many microseconds pass; samples are taken meanwhile
 *   L           the link is opened anew
 *   P           the operator presses the button
 *   R           reset: begun anew with the same store
 *   W u16       so many bytes fit into the link from now on, each step
 *   E type counter payload    said: the frame of this packet, by the encoder
 *   D bytes     said: every packet in these bytes (u16 size, first bytes), by a decoder of its own
 *   F u16       so many bytes go into the store from now on, then its power fails; 65535: all
 *   N u64       said: as milli, as f64 of the low 32 bits, as f32 of these / 1000
 */
#include "../core/pfwd_internal.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define STORE 20000u
#define OUTPUT 65536u

typedef struct {
    uint64_t now;
    const uint8_t *in;
    size_t in_size;
    uint8_t out[OUTPUT];
    size_t out_size;
    size_t room;
    uint64_t sampled;
    uint32_t rate;
    uint64_t taken;
    uint64_t began;
    bool shunt;
    uint32_t random;
    uint32_t store_left;
    uint8_t store[STORE];
} steps;

static const pfwd_channel channels[] = {
    {"load", PFWD_LOAD, 0.0, 4e-4, 0.0, -1.0, -1.0, 5000.0, 20260302u, 20280302u},
    {"centre", PFWD_GEOPHONE, 0.0, 28.8, 0.0, 4.5, 0.6, -1.0, 0u, 0u},
};
static const uint32_t rates[] = {10000u, 1000u, 50000u};
static const pfwd_identity identity = {
    .serial_number = "STEPS",
    .model = "Steps",
    .firmware = "1",
    .adc_bits = 18,
    .adc_range = 5.0,
    .plate_radius = 0.15,
    .plate_mass = PFWD_NOT_SAID,
    .channels = 2,
    .channel = channels,
    .rates = rates,
    .rate_count = 3,
    .shunt_counts = 52429,
    .streams = true,
    .drop_samples = 600,
};

static size_t write_bytes(void *context, const uint8_t *data, size_t size)
{
    steps *self = context;
    if (size > self->room) {
        size = self->room;
    }
    if (size > OUTPUT - self->out_size) {
        size = OUTPUT - self->out_size;
    }
    memcpy(self->out + self->out_size, data, size);
    self->out_size += size;
    self->room -= size;
    return size;
}

static size_t read_bytes(void *context, uint8_t *data, size_t size)
{
    steps *self = context;
    if (size > self->in_size) {
        size = self->in_size;
    }
    if (size > 0) {
        memcpy(data, self->in, size);
        self->in += size;
        self->in_size -= size;
    }
    return size;
}

static uint64_t time_us(void *context)
{
    return ((steps *)context)->now;
}

static void sample(void *context, uint32_t rate)
{
    steps *self = context;
    self->rate = rate;
    self->began = self->now;
    self->taken = 0;
}

/* A pulse of 20 ms every 0.3 s; in the second channel the number of the sample. */
static size_t samples(void *context, int32_t *values, size_t sets, uint32_t *lost)
{
    steps *self = context;
    const uint64_t due = (self->now - self->began) * self->rate / 1000000u;
    size_t count = 0;
    if (due > self->taken + 30000u) { /* as a converter whose buffer ran over */
        *lost = (uint32_t)(due - self->taken - 30000u);
        self->taken = due - 30000u;
    }
    while (count < sets && self->taken < due) {
        const uint64_t at = self->taken % 3000u;
        *values++ = at >= 1000u && at < 1200u ? (int32_t)(8000u + 10u * at) : (int32_t)(at & 3u);
        *values++ = (int32_t)(self->taken & 0x1FFFFu);
        self->taken++;
        count++;
    }
    return count;
}

static void shunt(void *context, bool on)
{
    ((steps *)context)->shunt = on;
}

static uint32_t random_bits(void *context)
{
    steps *self = context;
    self->random = self->random * 1664525u + 1013904223u;
    return self->random;
}

static bool store_read(void *context, uint32_t at, uint8_t *data, size_t size)
{
    const steps *self = context;
    if (at > STORE || size > STORE - at) {
        abort(); /* the core never reaches beyond its store */
    }
    memcpy(data, self->store + at, size);
    return true;
}

static bool store_write(void *context, uint32_t at, const uint8_t *data, size_t size)
{
    steps *self = context;
    if (at > STORE || size > STORE - at) {
        abort();
    }
    const size_t written = size < self->store_left ? size : self->store_left;
    memcpy(self->store + at, data, written);
    if (self->store_left != UINT32_MAX) {
        self->store_left -= (uint32_t)written;
    }
    return written == size;
}

static const pfwd_board board = {.write = write_bytes,
                                 .read = read_bytes,
                                 .time_us = time_us,
                                 .sample = sample,
                                 .samples = samples,
                                 .shunt = shunt,
                                 .random = random_bits,
                                 .store_read = store_read,
                                 .store_write = store_write,
                                 .store_size = STORE};
static pfwd_instrument core;
static steps self;
static uint8_t memory[12000];

static void begin(void)
{
    if (!pfwd_begin(&core, &board, &self, &identity, memory, sizeof memory)) {
        abort();
    }
}

static void begin_anew(void)
{
    memset(&self, 0, sizeof self);
    self.random = 1;
    self.store_left = UINT32_MAX;
    self.room = OUTPUT;
    begin();
}

static void say(const uint8_t *data, size_t size)
{
    if (size <= OUTPUT - self.out_size) {
        memcpy(self.out + self.out_size, data, size);
        self.out_size += size;
    }
}

static void encode(const uint8_t *data, size_t size)
{
    uint8_t packet[PFWD_PACKET_MAX];
    uint8_t frame[PFWD_FRAME_MAX];
    if (size < 3 || size - 3 > PFWD_PAYLOAD_MAX) {
        return;
    }
    memcpy(packet + 3, data + 3, size - 3);
    const uint16_t counter = (uint16_t)(data[1] | data[2] << 8);
    say(frame, pfwd_frame(frame, packet, (uint32_t)size - 3u, data[0], counter));
}

static void decode(const uint8_t *data, size_t size)
{
    pfwd_deframer in;
    pfwd_deframer_reset(&in);
    for (size_t i = 0; i < size; i++) {
        if (pfwd_deframe(&in, data[i])) {
            uint8_t head[4];
            pfwd_put(head, in.size, 4);
            say(head, sizeof head);
            say(in.kept, in.size < PFWD_KEPT_BYTES ? in.size : PFWD_KEPT_BYTES);
        }
    }
}

static void convert(const uint8_t *data)
{
    const uint64_t bits = pfwd_get(data, 8);
    uint64_t milli = 0;
    uint8_t found[21];
    found[0] = pfwd_f64_as_milli(bits, &milli) ? 1 : 0;
    pfwd_put(found + 1, milli, 8);
    pfwd_put(found + 9, pfwd_whole_as_f64((uint32_t)bits), 8);
    pfwd_put(found + 17, pfwd_milli_as_f32((int32_t)(uint32_t)bits), 4);
    say(found, sizeof found);
}

static void step(uint8_t letter, const uint8_t *data, size_t size)
{
    self.out_size = 0;
    if (self.room > 0) {
        self.room = OUTPUT;
    }
    switch (letter) {
    case 'B':
        self.in = data;
        self.in_size = size;
        break;
    case 'T':
        self.now += size >= 4 ? pfwd_get(data, 4) % 20000000u : 1000u;
        break;
    case 'L': pfwd_link_opened(&core); break;
    case 'P': pfwd_button(&core); break;
    case 'R':
        begin();
        break;
    case 'W': self.room = size >= 2 ? (size_t)pfwd_get(data, 2) : OUTPUT; break;
    case 'F':
        self.store_left = size >= 2 ? (uint32_t)pfwd_get(data, 2) : 0xFFFFu;
        if (self.store_left == 0xFFFFu) {
            self.store_left = UINT32_MAX;
        }
        break;
    case 'E': encode(data, size); return;
    case 'D': decode(data, size); return;
    case 'N':
        if (size >= 8) {
            convert(data);
        }
        return;
    default: break;
    }
    pfwd_poll(&core);
    self.in_size = 0;
}

#ifdef PFWD_LIBFUZZER
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    begin_anew();
    while (size >= 2) {
        /* Shorter records than those of the pipe, and bytes that are framed for it: a fuzzer finds
         * no CRC by itself. */
        const uint8_t letter = data[0];
        size_t length = data[1];
        data += 2;
        size -= 2;
        length = length < size ? length : size;
        if (letter < 128 && length > 0 && length < 200) {
            uint8_t packet[256];
            uint8_t frame[300];
            memcpy(packet + 3, data + 1, length - 1);
            const uint32_t framed = pfwd_frame(frame, packet, (uint32_t)length - 1u, data[0], 0);
            step('B', frame, framed);
        } else {
            static const char letters[] = "BTLPRWEDNF";
            step((uint8_t)letters[letter % 10u], data, length);
        }
        data += length;
        size -= length;
    }
    return 0;
}
#else
int main(void)
{
    static uint8_t data[65536];
    uint8_t head[3];
    begin_anew();
    while (fread(head, 1, sizeof head, stdin) == sizeof head) {
        const size_t size = (size_t)pfwd_get(head + 1, 2);
        if (fread(data, 1, size, stdin) != size) {
            break;
        }
        step(head[0], data, size);
        uint8_t length[4];
        pfwd_put(length, self.out_size, 4);
        fwrite(length, 1, sizeof length, stdout);
        fwrite(self.out, 1, self.out_size, stdout);
        fflush(stdout);
    }
    return 0;
}
#endif
