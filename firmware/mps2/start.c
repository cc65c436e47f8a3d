/* Vectors and start of a Cortex-M3 without any library. */
#include <stddef.h>
#include <stdint.h>

extern uint32_t stack_top, bss_begin, bss_end;
int main(void);
void tick(void);
void uart_received(void);

void *memcpy(void *to, const void *from, size_t size);
void *memset(void *to, int value, size_t size);
void *memmove(void *to, const void *from, size_t size);
int memcmp(const void *first, const void *other, size_t size);
void start(void);

/* The compiler may call these wherever it likes. */
void *memcpy(void *to, const void *from, size_t size)
{
    volatile uint8_t *at = to;
    const uint8_t *source = from;
    while (size-- > 0) {
        *at++ = *source++;
    }
    return to;
}

void *memmove(void *to, const void *from, size_t size)
{
    volatile uint8_t *at = to;
    const uint8_t *source = from;
    if ((uintptr_t)to <= (uintptr_t)from) {
        return memcpy(to, from, size);
    }
    while (size-- > 0) {
        at[size] = source[size];
    }
    return to;
}

void *memset(void *to, int value, size_t size)
{
    volatile uint8_t *at = to;
    while (size-- > 0) {
        *at++ = (uint8_t)value;
    }
    return to;
}

int memcmp(const void *first, const void *other, size_t size)
{
    const uint8_t *a = first;
    const uint8_t *b = other;
    for (; size > 0; size--, a++, b++) {
        if (*a != *b) {
            return *a < *b ? -1 : 1;
        }
    }
    return 0;
}

void start(void)
{
    for (uint32_t *at = &bss_begin; at < &bss_end; at++) {
        *at = 0;
    }
    main();
    for (;;) {
    }
}

static void halt(void)
{
    for (;;) {
    }
}

typedef void (*vector)(void);

__attribute__((section(".vectors"), used)) static const struct {
    const void *stack;
    vector others[16];
} vectors = {&stack_top,
             {start, halt, halt, halt, halt, halt, halt, halt, halt, halt, halt, halt, halt, halt,
              tick, uart_received}};
