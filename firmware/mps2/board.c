/* The core on a Cortex-M3 that QEMU emulates (machine mps2-an385), bare metal.
 *
 * UART0 is the link, timer 0 the clock; the converter is a table in the image (written by
 * simulators/emulated.py), played round and round at its rate. Nothing lasts over a
 * reset.
 */
#include "../core/pfwd.h"

#include "table.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define UART_DATA REGISTER(0x40004000u)
#define UART_STATE REGISTER(0x40004004u)
#define UART_CTRL REGISTER(0x40004008u)
#define UART_INTERRUPT REGISTER(0x4000400Cu)
#define UART_BAUDDIV REGISTER(0x40004010u)
#define NVIC_ENABLE REGISTER(0xE000E100u)
#define SYSTICK_CTRL REGISTER(0xE000E010u)
#define SYSTICK_RELOAD REGISTER(0xE000E014u)
#define UART_TX_FULL 1u
#define UART_RX_FULL 2u
#define TIMER_CTRL REGISTER(0x40000000u)
#define TIMER_VALUE REGISTER(0x40000004u)
#define TIMER_RELOAD REGISTER(0x40000008u)
#define TICKS_PER_US 25u

#define RING_BYTES 49152u

typedef struct {
    uint64_t ticks;
    uint32_t last;
    uint64_t run_began;
    uint64_t taken;
    uint64_t position;
    uint32_t rate;
    bool shunt;
    uint32_t random;
} board;

static board self;
static pfwd_instrument core;
static uint8_t ring[RING_BYTES] __attribute__((section(".ring"), aligned(4)));

static uint64_t time_us(void *context)
{
    board *b = context;
    const uint32_t now = TIMER_VALUE;
    b->ticks += (uint32_t)(b->last - now); /* it counts down */
    b->last = now;
    return b->ticks / TICKS_PER_US;
}

static size_t write_bytes(void *context, const uint8_t *data, size_t size)
{
    (void)context;
    size_t sent = 0;
    while (sent < size && (UART_STATE & UART_TX_FULL) == 0) {
        UART_DATA = data[sent++];
    }
    return sent;
}

/* Bytes that came, put in by the interrupt and taken out by the main loop. */
static volatile uint8_t received[512];
static volatile uint32_t received_in, received_out;

void uart_received(void);
void tick(void);

void uart_received(void)
{
    UART_INTERRUPT = 2;
    while ((UART_STATE & UART_RX_FULL) != 0) {
        received[received_in % sizeof received] = (uint8_t)(UART_DATA & 0xFFu);
        received_in = received_in + 1u;
    }
}

void tick(void)
{
    /* Wakes the main loop, and does nothing else. */
}

static size_t read_bytes(void *context, uint8_t *data, size_t size)
{
    (void)context;
    size_t count = 0;
    while (count < size && received_out != received_in) {
        data[count++] = received[received_out % sizeof received];
        received_out = received_out + 1u;
    }
    return count;
}

static void sample(void *context, uint32_t rate)
{
    board *b = context;
    b->rate = rate;
    b->run_began = time_us(b);
    b->taken = 0;
}

static size_t samples(void *context, int32_t *values, size_t sets, uint32_t *lost)
{
    board *b = context;
    (void)lost;
    const uint64_t due = (time_us(b) - b->run_began) * b->rate / 1000000u;
    size_t count = 0;
    while (count < sets && b->taken < due) {
        const uint64_t at = b->position % TABLE_SETS;
        for (uint32_t channel = 0; channel < TABLE_CHANNELS; channel++) {
            *values++ = table[at * TABLE_CHANNELS + channel];
        }
        if (b->shunt) {
            values[-(int)TABLE_CHANNELS + (int)table_identity.shunt_channel] +=
                table_identity.shunt_counts;
        }
        b->position++;
        b->taken++;
        count++;
    }
    return count;
}

static void shunt(void *context, bool on)
{
    ((board *)context)->shunt = on;
}

static uint32_t random_bits(void *context)
{
    /* How long the host took to open the port, in ticks: no two starts are alike. */
    board *b = context;
    b->random = b->random * 1664525u + 1013904223u + TIMER_VALUE;
    return b->random;
}

int main(void)
{
    static const pfwd_board functions = {.write = write_bytes,
                                         .read = read_bytes,
                                         .time_us = time_us,
                                         .sample = sample,
                                         .samples = samples,
                                         .shunt = shunt,
                                         .random = random_bits};
    UART_BAUDDIV = 217; /* 115200 baud of 25 MHz */
    UART_CTRL = 0xB; /* send, receive, interrupt for what comes */
    NVIC_ENABLE = 1;
    SYSTICK_RELOAD = 25000u - 1u; /* every millisecond */
    SYSTICK_CTRL = 7;
    TIMER_RELOAD = 0xFFFFFFFFu;
    TIMER_VALUE = 0xFFFFFFFFu;
    TIMER_CTRL = 1;
    self.last = TIMER_VALUE;
    if (!pfwd_begin(&core, &functions, &self, &table_identity, ring, sizeof ring)) {
        for (;;) {
        }
    }
    for (;;) {
        pfwd_poll(&core);
        __asm__ volatile("wfi");
    }
}
