/* The core as a process: an instrument at a TCP port or a pseudo-terminal that plays samples.
 *
 * What it plays comes from a file (simulators/firmware.py writes it: finite-element drops, or a
 * trace file). Its first line on standard output is where to connect; it ends when its standard
 * input does. The store is a file, so that drops outlast the process.
 */
#ifndef _WIN32
#define _XOPEN_SOURCE 700
#define _DARWIN_C_SOURCE
#define _DEFAULT_SOURCE
#endif
#include "../core/pfwd.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#ifdef _WIN32
#include <winsock2.h>
#include <ws2tcpip.h>
#include <windows.h>
typedef SOCKET link_t;
typedef int link_size_t;
#define NO_LINK INVALID_SOCKET
#define MSG_QUIET 0
#else
#include <fcntl.h>
#include <poll.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <arpa/inet.h>
#include <signal.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>
typedef int link_t;
typedef size_t link_size_t;
#define NO_LINK (-1)
#ifdef MSG_NOSIGNAL
#define MSG_QUIET MSG_NOSIGNAL
#else
#define MSG_QUIET 0
#endif
#endif

#define MOST_RATES 8

typedef struct {
    /* What is played */
    int32_t *play;
    uint32_t play_channels;
    uint64_t play_sets;
    uint64_t position;
    bool loop;
    bool ended;
    /* Time */
    double speed;
    uint64_t origin_us;
    uint64_t run_began;
    uint64_t run_taken;
    uint32_t run_rate;
    bool shunt;
    /* Link */
    link_t listener;
    link_t peer;
    int pty;
    bool pty_open;
    double link_rate; /* bytes a second, 0: as fast as it goes */
    double tokens;
    uint64_t tokens_at;
    /* Store */
    FILE *store;
    FILE *log;
    /* Identity */
    pfwd_identity identity;
    pfwd_channel channels[PFWD_MOST_CHANNELS];
    uint32_t rates[MOST_RATES];
    uint32_t random;
} host;

static uint64_t real_us(void)
{
#ifdef _WIN32
    LARGE_INTEGER count, frequency;
    QueryPerformanceCounter(&count);
    QueryPerformanceFrequency(&frequency);
    return (uint64_t)((double)count.QuadPart * 1e6 / (double)frequency.QuadPart);
#else
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u;
#endif
}

static uint64_t time_us(void *context)
{
    const host *self = context;
    return (uint64_t)((double)(real_us() - self->origin_us) * self->speed);
}

static void drop_peer(host *self)
{
    if (self->peer != NO_LINK) {
#ifdef _WIN32
        closesocket(self->peer);
#else
        close(self->peer);
#endif
        self->peer = NO_LINK;
    }
}

static bool would_wait(void)
{
#ifdef _WIN32
    return WSAGetLastError() == WSAEWOULDBLOCK;
#else
    return errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR;
#endif
}

static size_t write_bytes(void *context, const uint8_t *data, size_t size)
{
    host *self = context;
    if (self->link_rate > 0) {
        const uint64_t now = real_us();
        self->tokens += (double)(now - self->tokens_at) * 1e-6 * self->link_rate;
        self->tokens_at = now;
        if (self->tokens > self->link_rate * 0.02) { /* as a small queue of a port holds */
            self->tokens = self->link_rate * 0.02;
        }
        if (self->tokens < 1) {
            return 0;
        }
        if ((double)size > self->tokens) {
            size = (size_t)self->tokens;
        }
    }
    long sent = 0;
#ifndef _WIN32
    if (self->pty >= 0) {
        sent = self->pty_open ? (long)write(self->pty, data, size) : 0;
    } else
#endif
    if (self->peer != NO_LINK) {
        sent = (long)send(self->peer, (const char *)data, (link_size_t)size, MSG_QUIET);
        if (sent < 0 && !would_wait()) {
            drop_peer(self);
        }
    } else if (self->link_rate > 0) {
        sent = (long)size; /* a wire takes bytes whether anybody listens or not */
    }
    if (sent <= 0) {
        return 0;
    }
    self->tokens -= (double)sent;
    return (size_t)sent;
}

static size_t read_bytes(void *context, uint8_t *data, size_t size)
{
    host *self = context;
    long count = -1;
#ifndef _WIN32
    if (self->pty >= 0) {
        count = self->pty_open ? (long)read(self->pty, data, size) : 0;
    } else
#endif
    if (self->peer != NO_LINK) {
        count = (long)recv(self->peer, (char *)data, (link_size_t)size, 0);
        if (count == 0 || (count < 0 && !would_wait())) {
            drop_peer(self);
        }
    }
    return count > 0 ? (size_t)count : 0;
}

static void sample(void *context, uint32_t rate)
{
    host *self = context;
    self->run_rate = rate;
    self->run_began = time_us(self);
    self->run_taken = 0;
}

static size_t samples(void *context, int32_t *values, size_t sets, uint32_t *lost)
{
    host *self = context;
    (void)lost;
    const uint64_t due =
        (uint64_t)((double)(time_us(self) - self->run_began) * 1e-6 * (double)self->run_rate);
    size_t count = 0;
    const uint32_t channels = self->identity.channels;
    const int32_t full = (int32_t)1 << (self->identity.adc_bits - 1);
    while (count < sets && self->run_taken < due) {
        uint64_t at = self->position;
        if (at >= self->play_sets) {
            self->ended = !self->loop;
            at = self->loop ? at % self->play_sets : self->play_sets - 1u;
        }
        memcpy(values, self->play + at * channels, channels * sizeof *values);
        if (self->shunt) {
            int32_t *value = values + self->identity.shunt_channel;
            *value += self->identity.shunt_counts;
            *value = *value >= full ? full - 1 : *value;
        }
        values += channels;
        self->position++;
        self->run_taken++;
        count++;
    }
    return count;
}

static void shunt(void *context, bool on)
{
    ((host *)context)->shunt = on;
}

static uint32_t random_bits(void *context)
{
    host *self = context;
    self->random ^= self->random << 13; /* xorshift, after Marsaglia (2003) */
    self->random ^= self->random >> 17;
    self->random ^= self->random << 5;
    return self->random;
}

static bool store_read(void *context, uint32_t at, uint8_t *data, size_t size)
{
    host *self = context;
    return fseek(self->store, (long)at, SEEK_SET) == 0 &&
           fread(data, 1, size, self->store) == size;
}

static bool store_write(void *context, uint32_t at, const uint8_t *data, size_t size)
{
    host *self = context;
    return fseek(self->store, (long)at, SEEK_SET) == 0 &&
           fwrite(data, 1, size, self->store) == size && fflush(self->store) == 0;
}

static void health(void *context, pfwd_health *is)
{
    (void)context;
    is->battery_mv = 7400;
    is->temperature_mc = 21500;
    is->temperature_known = true;
}

static void fail(const char *what, const char *which)
{
    fprintf(stderr, "board: %s: %s\n", which, what);
    exit(2);
}

static char *copied(const char *text)
{
    char *copy = malloc(strlen(text) + 1);
    if (copy == NULL) {
        fail("no memory", "identity");
    }
    return strcpy(copy, text);
}

static double number(const char *text, const char *key)
{
    char *end;
    const double value = strtod(text, &end);
    if (end == text) {
        fail("expected a number", key);
    }
    return value;
}

static void read_channel(pfwd_channel *channel, char *text)
{
    char *fields[10];
    for (int i = 0; i < 10; i++) {
        fields[i] = text;
        char *bar = strchr(text, '|');
        if (bar == NULL && i < 9) {
            fail("expected ten fields with | between them", "channel");
        }
        if (bar != NULL) {
            *bar = '\0';
            text = bar + 1;
        }
    }
    channel->name = copied(fields[0]);
    channel->role = (uint8_t)number(fields[1], "role");
    channel->offset = number(fields[2], "offset");
    channel->sensitivity = number(fields[3], "sensitivity");
    channel->zero = number(fields[4], "zero");
    channel->natural_frequency = number(fields[5], "natural_frequency");
    channel->damping = number(fields[6], "damping");
    channel->shunt = number(fields[7], "shunt");
    channel->calibrated = (uint32_t)number(fields[8], "calibrated");
    channel->due = (uint32_t)number(fields[9], "due");
}

static void read_identity(host *self, const char *path)
{
    FILE *file = fopen(path, "r");
    if (file == NULL) {
        fail("cannot be read", path);
    }
    pfwd_identity *identity = &self->identity;
    memset(identity, 0, sizeof *identity);
    identity->channel = self->channels;
    identity->rates = self->rates;
    char line[512];
    while (fgets(line, sizeof line, file) != NULL) {
        line[strcspn(line, "\r\n")] = '\0';
        char *value = strchr(line, '=');
        if (value == NULL) {
            continue;
        }
        *value++ = '\0';
        if (strcmp(line, "serial_number") == 0) {
            identity->serial_number = copied(value);
        } else if (strcmp(line, "model") == 0) {
            identity->model = copied(value);
        } else if (strcmp(line, "firmware") == 0) {
            identity->firmware = copied(value);
        } else if (strcmp(line, "adc_bits") == 0) {
            identity->adc_bits = (uint8_t)number(value, line);
        } else if (strcmp(line, "adc_range") == 0) {
            identity->adc_range = number(value, line);
        } else if (strcmp(line, "plate_radius") == 0) {
            identity->plate_radius = number(value, line);
        } else if (strcmp(line, "plate_mass") == 0) {
            identity->plate_mass = number(value, line);
        } else if (strcmp(line, "centre_seat") == 0) {
            identity->centre_seat = (uint8_t)number(value, line);
        } else if (strcmp(line, "streams") == 0) {
            identity->streams = number(value, line) != 0;
        } else if (strcmp(line, "drop_samples") == 0) {
            identity->drop_samples = (uint32_t)number(value, line);
        } else if (strcmp(line, "shunt_channel") == 0) {
            identity->shunt_channel = (uint8_t)number(value, line);
        } else if (strcmp(line, "shunt_counts") == 0) {
            identity->shunt_counts = (int32_t)number(value, line);
        } else if (strcmp(line, "rate") == 0 && identity->rate_count < MOST_RATES) {
            self->rates[identity->rate_count++] = (uint32_t)number(value, line);
        } else if (strcmp(line, "channel") == 0 && identity->channels < PFWD_MOST_CHANNELS) {
            read_channel(&self->channels[identity->channels++], value);
        } else {
            fail("unknown", line);
        }
    }
    fclose(file);
    if (identity->channels == 0 || identity->rate_count == 0) {
        fail("expected channels and rates", path);
    }
}

static void read_play(host *self, const char *path)
{
    FILE *file = fopen(path, "rb");
    if (file == NULL) {
        fail("cannot be read", path);
    }
    uint8_t head[16];
    if (fread(head, 1, sizeof head, file) != sizeof head || memcmp(head, "PFWDPLAY", 8) != 0) {
        fail("expected a file of samples to play", path);
    }
    self->play_channels = (uint32_t)head[8] | (uint32_t)head[9] << 8;
    self->play_sets = (uint64_t)head[12] | (uint64_t)head[13] << 8 | (uint64_t)head[14] << 16 |
                      (uint64_t)head[15] << 24;
    if (self->play_channels != self->identity.channels || self->play_sets == 0) {
        fail("expected as many channels as in the identity", path);
    }
    const size_t values = (size_t)(self->play_sets * self->play_channels);
    uint8_t *bytes = malloc(4 * values);
    self->play = malloc(values * sizeof *self->play);
    if (bytes == NULL || self->play == NULL || fread(bytes, 4, values, file) != values) {
        fail("expected as many samples as it says", path);
    }
    for (size_t i = 0; i < values; i++) {
        const uint32_t value = (uint32_t)bytes[4 * i] | (uint32_t)bytes[4 * i + 1] << 8 |
                               (uint32_t)bytes[4 * i + 2] << 16 | (uint32_t)bytes[4 * i + 3] << 24;
        self->play[i] = (int32_t)value;
    }
    free(bytes);
    fclose(file);
}

static void open_store(host *self, const char *path, uint32_t size)
{
    self->store = fopen(path, "r+b");
    if (self->store == NULL) {
        self->store = fopen(path, "w+b");
    }
    if (self->store == NULL) {
        fail("cannot be written", path);
    }
    fseek(self->store, 0, SEEK_END);
    for (long at = ftell(self->store); at >= 0 && at < (long)size; at++) {
        fputc(0xFF, self->store);
    }
    fflush(self->store);
}

static void set_waiting(link_t peer)
{
#ifdef _WIN32
    u_long on = 1;
    ioctlsocket(peer, (long)FIONBIO, &on);
#else
    fcntl(peer, F_SETFL, fcntl(peer, F_GETFL) | O_NONBLOCK);
#endif
}

static void listen_tcp(host *self, const char *address)
{
    char name[64];
    const char *colon = strrchr(address, ':');
    if (colon == NULL || (size_t)(colon - address) >= sizeof name) {
        fail("expected tcp://HOST:PORT", address);
    }
    memcpy(name, address, (size_t)(colon - address));
    name[colon - address] = '\0';
    struct sockaddr_in at;
    memset(&at, 0, sizeof at);
    at.sin_family = AF_INET;
    at.sin_port = htons((uint16_t)atoi(colon + 1));
    if (inet_pton(AF_INET, name, &at.sin_addr) != 1) {
        fail("expected an address as 127.0.0.1", name);
    }
    self->listener = socket(AF_INET, SOCK_STREAM, 0);
#ifndef _WIN32
    const int on = 1;
    setsockopt(self->listener, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
#endif
    socklen_t size = sizeof at;
    if (self->listener == NO_LINK || bind(self->listener, (struct sockaddr *)&at, size) != 0 ||
        listen(self->listener, 1) != 0 ||
        getsockname(self->listener, (struct sockaddr *)&at, &size) != 0) {
        fail("cannot be listened at; try another port, or 0 for any", address);
    }
    set_waiting(self->listener);
    printf("socket://%s:%d\n", name, ntohs(at.sin_port));
}

static void accept_peer(host *self, pfwd_instrument *core)
{
    link_t peer = accept(self->listener, NULL, NULL);
    if (peer == NO_LINK) {
        return;
    }
    drop_peer(self); /* whoever comes anew has lost the old one */
    set_waiting(peer);
    const int on = 1;
    setsockopt(peer, IPPROTO_TCP, TCP_NODELAY, (const char *)&on, sizeof on);
#ifdef SO_NOSIGPIPE
    setsockopt(peer, SOL_SOCKET, SO_NOSIGPIPE, &on, sizeof on);
#endif
    self->peer = peer;
    pfwd_link_opened(core);
}

#ifndef _WIN32
static void open_pty(host *self)
{
    self->pty = posix_openpt(O_RDWR | O_NOCTTY);
    const char *name = NULL;
    if (self->pty < 0 || grantpt(self->pty) != 0 || unlockpt(self->pty) != 0 ||
        (name = ptsname(self->pty)) == NULL) {
        fail("cannot be made", "pseudo-terminal");
    }
    const int slave = open(name, O_RDWR | O_NOCTTY);
    struct termios settings;
    if (slave >= 0 && tcgetattr(slave, &settings) == 0) {
        settings.c_iflag = settings.c_oflag = settings.c_lflag = 0;
        settings.c_cflag |= CS8;
        tcsetattr(slave, TCSANOW, &settings);
    }
    if (slave >= 0) {
        close(slave); /* from now on a hang-up says that nobody has it open */
    }
    fcntl(self->pty, F_SETFL, O_NONBLOCK);
    printf("%s\n", name);
}

static void look_at_pty(host *self, pfwd_instrument *core)
{
    struct pollfd look = {self->pty, POLLIN, 0};
    const bool open = poll(&look, 1, 0) >= 0 && (look.revents & POLLHUP) == 0;
    if (open && !self->pty_open) {
        pfwd_link_opened(core);
    }
    self->pty_open = open;
}
#endif

static bool caller_is_gone(void)
{
#ifdef _WIN32
    DWORD waiting = 0;
    return !PeekNamedPipe(GetStdHandle(STD_INPUT_HANDLE), NULL, 0, NULL, &waiting, NULL);
#else
    fd_set set;
    struct timeval none = {0, 0};
    char bytes[256];
    FD_ZERO(&set);
    FD_SET(0, &set);
    return select(1, &set, NULL, NULL, &none) > 0 && read(0, bytes, sizeof bytes) <= 0;
#endif
}

static void rest(host *self)
{
#ifdef _WIN32
    (void)self;
    Sleep(1);
#else
    fd_set set;
    struct timeval nap = {0, 1000};
    FD_ZERO(&set);
    int last = -1;
    if (self->peer != NO_LINK) {
        FD_SET(self->peer, &set);
        last = self->peer;
    }
    select(last + 1, &set, NULL, NULL, &nap);
#endif
}

static void note_drops(host *self, const pfwd_instrument *core, bool *noted, uint32_t *orders)
{
    for (uint32_t i = 0; i < core->slot_count; i++) {
        const pfwd_slot *slot = &core->slots[i];
        if (slot->used && (!noted[i] || orders[i] != slot->order)) {
            fprintf(self->log, "kept %lu %llu %lu %lu\n", (unsigned long)slot->stream,
                    (unsigned long long)slot->first, (unsigned long)slot->samples,
                    (unsigned long)slot->crc);
            fflush(self->log);
        }
        noted[i] = slot->used;
        orders[i] = slot->order;
    }
}

static const char *option(int count, char **arguments, const char *name, const char *otherwise)
{
    for (int i = 1; i + 1 < count; i += 2) {
        if (strcmp(arguments[i], name) == 0) {
            return arguments[i + 1];
        }
    }
    return otherwise;
}

int main(int count, char **arguments)
{
    static host self;
    static pfwd_instrument core;
    self.listener = self.peer = NO_LINK;
    self.pty = -1;
#ifdef _WIN32
    WSADATA data;
    WSAStartup(MAKEWORD(2, 2), &data);
#else
    signal(SIGPIPE, SIG_IGN);
#endif
    const char *identity = option(count, arguments, "--identity", NULL);
    const char *play = option(count, arguments, "--play", NULL);
    if (identity == NULL || play == NULL) {
        fail("expected --identity FILE --play FILE [--listen tcp://127.0.0.1:0 or pty] [--store "
             "FILE] [--store-size BYTES] [--memory BYTES] [--speed X] [--link-rate BYTES] "
             "[--from SETS] [--loop 1] [--log FILE]",
             "usage");
    }
    read_identity(&self, identity);
    read_play(&self, play);
    self.speed = number(option(count, arguments, "--speed", "1"), "--speed");
    self.identity.other_speed = self.speed != 1;
    self.link_rate = number(option(count, arguments, "--link-rate", "0"), "--link-rate");
    self.position = (uint64_t)number(option(count, arguments, "--from", "0"), "--from");
    self.loop = number(option(count, arguments, "--loop", "0"), "--loop") != 0;
    self.origin_us = self.tokens_at = real_us();
    const char *store = option(count, arguments, "--store", NULL);
    const char *log = option(count, arguments, "--log", NULL);
    const uint32_t memory =
        (uint32_t)number(option(count, arguments, "--memory", "262144"), "--memory");
    pfwd_board board = {.write = write_bytes,
                        .read = read_bytes,
                        .time_us = time_us,
                        .sample = sample,
                        .samples = samples,
                        .shunt = shunt,
                        .random = random_bits,
                        .health = health};
    if (store != NULL) {
        board.store_size =
            (uint32_t)number(option(count, arguments, "--store-size", "262144"), "--store-size");
        board.store_read = store_read;
        board.store_write = store_write;
        open_store(&self, store, board.store_size);
    }
    if (log != NULL && (self.log = fopen(log, "a")) == NULL) {
        fail("cannot be written", log);
    }
    self.random = (uint32_t)(real_us() * 2654435761u) ^ (uint32_t)time(NULL) * 40503u;
#ifndef _WIN32
    self.random ^= (uint32_t)getpid() << 16;
#endif
    self.random |= 1u;
    uint8_t *ring = malloc(memory);
    if (ring == NULL ||
        !pfwd_begin(&core, &board, &self, &self.identity, ring, memory)) {
        fail("expected memory for at least 64 samples", "--memory");
    }
    const char *place = option(count, arguments, "--listen", "tcp://127.0.0.1:0");
    if (strncmp(place, "tcp://", 6) == 0) {
        listen_tcp(&self, place + 6);
    } else {
#ifdef _WIN32
        fail("expected tcp://HOST:PORT; there are no pseudo-terminals here", place);
#else
        open_pty(&self);
#endif
    }
    fflush(stdout);
    bool noted[PFWD_MOST_SLOTS] = {false};
    uint32_t orders[PFWD_MOST_SLOTS] = {0};
    bool told_end = false;
    while (!caller_is_gone()) {
#ifndef _WIN32
        if (self.pty >= 0) {
            look_at_pty(&self, &core);
        } else
#endif
        {
            accept_peer(&self, &core);
        }
        pfwd_poll(&core);
        if (self.log != NULL) {
            note_drops(&self, &core, noted, orders);
        }
        if (self.ended && !told_end && pfwd_drops_waiting(&core) == 0 &&
            core.send_next == core.next) {
            told_end = true;
            pfwd_say_event(&core, 4); /* there is nothing more to come */
        }
        rest(&self);
    }
    return 0;
}
