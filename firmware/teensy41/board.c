/* NEVER RUN ON HARDWARE: the core on a Teensy 4.1 (i.MX RT1062) with an ADS131M04 over SPI.
 *
 * Written from the makers' manuals alone: NXP IMXRT1060RM rev. 3 (LPSPI4, LPUART6, GPIO2, DWT) and
 * Texas Instruments SBAS890 (ADS131M04). It compiles in the checks and no more. Whoever runs it
 * should say so here, with what had to be changed.
 *
 * Wiring: SCLK pin 13, DIN pin 11, DOUT pin 12, CS pin 10, DRDY pin 9, SYNC/RESET pin 8; the
 * converter's clock is 8.192 MHz. Load cell amplifier on AIN0, geophone on AIN1, shunt relay on
 * pin 7. The link is Serial1 (pins 0 and 1) at 115200 baud: no stream, drops are kept. The start-up
 * code, the clocks (SPI 60 MHz, UART 24 MHz) and the pins' multiplexers are those of the maker's kit;
 * `board_main` is called from its `setup`. Drops are gone when it is switched off: a FRAM behind
 * `store_read` and `store_write` would keep them.
 */
#include "../core/pfwd.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))

#define LPUART6 0x40198000u
#define UART_BAUD REGISTER(LPUART6 + 0x10u)
#define UART_STAT REGISTER(LPUART6 + 0x14u)
#define UART_CTRL REGISTER(LPUART6 + 0x18u)
#define UART_DATA REGISTER(LPUART6 + 0x1Cu)
#define STAT_TDRE (1u << 23)
#define STAT_RDRF (1u << 21)
#define STAT_OVERRUN (1u << 19)
#define CTRL_RECEIVE_SEND (3u << 18)

#define LPSPI4 0x403A0000u
#define SPI_CR REGISTER(LPSPI4 + 0x10u)
#define SPI_SR REGISTER(LPSPI4 + 0x14u)
#define SPI_CFGR1 REGISTER(LPSPI4 + 0x24u)
#define SPI_CCR REGISTER(LPSPI4 + 0x40u)
#define SPI_TCR REGISTER(LPSPI4 + 0x60u)
#define SPI_TDR REGISTER(LPSPI4 + 0x64u)
#define SPI_RSR REGISTER(LPSPI4 + 0x70u)
#define SPI_RDR REGISTER(LPSPI4 + 0x74u)
#define RSR_EMPTY (1u << 1)
/* Mode 1 (CPHA), 24 bits a word, eight clocks of the module for one of the link. */
#define TCR_WORD ((1u << 30) | 23u)

#define GPIO7 0x42004000u /* fast GPIO of bank 2: pins 7 to 13 */
#define PIN_SET REGISTER(GPIO7 + 0x84u)
#define PIN_CLEAR REGISTER(GPIO7 + 0x88u)
#define PIN_STATE REGISTER(GPIO7 + 0x08u)
#define PIN_SHUNT (1u << 17)
#define PIN_RESET (1u << 16)
#define PIN_READY (1u << 11)
#define PIN_SELECT (1u << 0)

#define DEMCR REGISTER(0xE000EDFCu)
#define DWT_CTRL REGISTER(0xE0001000u)
#define DWT_CYCLES REGISTER(0xE0001004u)
#define CYCLES_PER_US 600u
#define TRNG_ENTROPY REGISTER(0x400CC040u)

#define CONVERTER_CHANNELS 4u
#define FRAME_WORDS 6u /* status, four channels, CRC */
#define WRITE_CLOCK 0x6180u
#define WRITE_GAIN 0x6200u
#define RING_SETS 256u
#define MEMORY_BYTES (256u * 1024u)

typedef struct {
    uint64_t cycles;
    uint32_t last;
    bool running;
    /* Sets that the interrupt of DRDY took, for the main loop. */
    volatile uint32_t in, out, lost;
    int32_t sets[RING_SETS][2];
} board;

static const pfwd_channel channels[] = {
    /* As calibrated: `pfwd calibrate` gives these numbers. */
    {"load", PFWD_LOAD, 0.0, 1.0e-4, 0.0, PFWD_NOT_SAID, PFWD_NOT_SAID, 5000.0, 0u, 0u},
    {"centre", PFWD_GEOPHONE, 0.0, 28.8, 0.0, 4.5, 0.56, PFWD_NOT_SAID, 0u, 0u},
};
static const uint32_t rates[] = {8000u}; /* 8.192 MHz, OSR 512 */
static const pfwd_identity identity = {
    .serial_number = "TEENSY-0000",
    .model = "Teensy 4.1, ADS131M04",
    .firmware = "never run",
    .adc_bits = 24,
    .adc_range = 1.2,
    .plate_radius = 0.15,
    .plate_mass = PFWD_NOT_SAID,
    .channels = 2,
    .channel = channels,
    .rates = rates,
    .rate_count = 1,
    .shunt_channel = 0,
    .shunt_counts = 3495253, /* 5000 N * 1e-4 V/N of 1.2 V */
    .streams = false,
    .drop_samples = 4000,
};

static board self;
static pfwd_instrument core;
static uint8_t memory[MEMORY_BYTES];

void board_main(void);
void board_data_ready(void);

static uint64_t time_us(void *context)
{
    board *b = context;
    const uint32_t now = DWT_CYCLES;
    b->cycles += (uint32_t)(now - b->last);
    b->last = now;
    return b->cycles / CYCLES_PER_US;
}

static size_t write_bytes(void *context, const uint8_t *data, size_t size)
{
    (void)context;
    size_t sent = 0;
    while (sent < size && (UART_STAT & STAT_TDRE) != 0) {
        UART_DATA = data[sent++];
    }
    return sent;
}

static size_t read_bytes(void *context, uint8_t *data, size_t size)
{
    (void)context;
    size_t count = 0;
    if ((UART_STAT & STAT_OVERRUN) != 0) {
        UART_STAT = UART_STAT | STAT_OVERRUN; /* written as 1 it is cleared; a frame is damaged */
    }
    while (count < size && (UART_STAT & STAT_RDRF) != 0) {
        data[count++] = (uint8_t)(UART_DATA & 0xFFu);
    }
    return count;
}

/* One word of 24 bits to the converter and one back. */
static uint32_t exchange(uint32_t word)
{
    SPI_TDR = word;
    while ((SPI_RSR & RSR_EMPTY) != 0) {
    }
    return SPI_RDR & 0xFFFFFFu;
}

static void write_register(uint32_t command, uint32_t value)
{
    PIN_CLEAR = PIN_SELECT;
    (void)exchange(command << 8);
    (void)exchange(value << 8);
    for (uint32_t word = 2; word < FRAME_WORDS; word++) {
        (void)exchange(0);
    }
    PIN_SET = PIN_SELECT;
}

/* To be called from the interrupt of DRDY's falling edge. */
void board_data_ready(void)
{
    uint32_t words[FRAME_WORDS];
    PIN_CLEAR = PIN_SELECT;
    for (uint32_t word = 0; word < FRAME_WORDS; word++) {
        words[word] = exchange(0);
    }
    PIN_SET = PIN_SELECT;
    if (!self.running) {
        return;
    }
    if (self.in - self.out >= RING_SETS) {
        self.lost = self.lost + 1u;
        return;
    }
    for (uint32_t channel = 0; channel < 2; channel++) {
        self.sets[self.in % RING_SETS][channel] =
            (int32_t)(words[1u + channel] ^ 0x800000u) - 0x800000;
    }
    self.in = self.in + 1u;
}

static void sample(void *context, uint32_t rate)
{
    board *b = context;
    b->running = false;
    b->in = b->out = b->lost = 0;
    b->running = rate > 0;
}

static size_t samples(void *context, int32_t *values, size_t sets, uint32_t *lost)
{
    board *b = context;
    size_t count = 0;
    while (count < sets && b->out != b->in) {
        *values++ = b->sets[b->out % RING_SETS][0];
        *values++ = b->sets[b->out % RING_SETS][1];
        b->out = b->out + 1u;
        count++;
    }
    if (count == 0 && b->lost > 0) { /* thrown away behind all that has been taken */
        *lost = b->lost;
        b->lost = 0;
    }
    return count;
}

static void shunt(void *context, bool on)
{
    (void)context;
    if (on) {
        PIN_SET = PIN_SHUNT;
    } else {
        PIN_CLEAR = PIN_SHUNT;
    }
}

static uint32_t random_bits(void *context)
{
    (void)context;
    return TRNG_ENTROPY ^ DWT_CYCLES;
}

void board_main(void)
{
    static const pfwd_board functions = {.write = write_bytes,
                                         .read = read_bytes,
                                         .time_us = time_us,
                                         .sample = sample,
                                         .samples = samples,
                                         .shunt = shunt,
                                         .random = random_bits};
    DEMCR = DEMCR | (1u << 24);
    DWT_CTRL = DWT_CTRL | 1u;
    self.last = DWT_CYCLES;
    UART_BAUD = (15u << 24) | 13u; /* 24 MHz / (16 * 13) = 115385 baud, 0.16 % off */
    UART_CTRL = CTRL_RECEIVE_SEND;
    SPI_CR = 2; /* reset, then on */
    SPI_CR = 0;
    SPI_CFGR1 = 1; /* master */
    SPI_CCR = 6;   /* 60 MHz / 8 */
    SPI_TCR = TCR_WORD;
    SPI_CR = 1;
    PIN_CLEAR = PIN_RESET;
    const uint64_t began = time_us(&self);
    while (time_us(&self) - began < 300u) { /* 2048 of the converter's clocks */
    }
    PIN_SET = PIN_RESET;
    write_register(WRITE_GAIN, 0);
    write_register(WRITE_CLOCK, 0x0F0Au); /* all channels, OSR 512, high resolution */
    if (!pfwd_begin(&core, &functions, &self, &identity, memory, sizeof memory)) {
        return;
    }
    for (;;) {
        pfwd_poll(&core);
    }
}
