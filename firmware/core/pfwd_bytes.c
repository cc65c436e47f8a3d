/* Numbers and texts as they travel, and the CRC over them. */
#include "pfwd_internal.h"

uint32_t pfwd_crc(uint32_t crc, const uint8_t *data, size_t size)
{
    /* Half a byte at a time: 64 bytes of table, and six times as fast as bit by bit. */
    static const uint32_t table[16] = {
        0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u,
        0x4DB26158u, 0x5005713Cu, 0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu,
        0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu,
    };
    crc = ~crc;
    while (size-- > 0) {
        crc ^= *data++;
        crc = (crc >> 4) ^ table[crc & 15u];
        crc = (crc >> 4) ^ table[crc & 15u];
    }
    return ~crc;
}

uint8_t *pfwd_put(uint8_t *at, uint64_t value, unsigned size)
{
    while (size-- > 0) {
        *at++ = (uint8_t)(value & 0xFFu);
        value >>= 8;
    }
    return at;
}

uint64_t pfwd_get(const uint8_t *at, unsigned size)
{
    uint64_t value = 0;
    while (size-- > 0) {
        value = (value << 8) | at[size];
    }
    return value;
}

uint8_t *pfwd_put_text(uint8_t *at, const char *text, size_t most)
{
    size_t size = 0;
    if (text != NULL) {
        while (size < most && text[size] != '\0') {
            size++;
        }
    }
    *at++ = (uint8_t)size;
    for (size_t i = 0; i < size; i++) {
        *at++ = (uint8_t)text[i];
    }
    return at;
}

static uint64_t bits_of(double value)
{
    union {
        double value;
        uint64_t bits;
    } both;
    both.value = value;
    return both.bits;
}

uint8_t *pfwd_put_double(uint8_t *at, double value)
{
    return pfwd_put(at, bits_of(value), 8);
}

uint8_t *pfwd_put_positive(uint8_t *at, double value)
{
    const uint64_t bits = bits_of(value);
    return pfwd_put(at, (bits >> 63) != 0 ? 0x7FF8000000000000u : bits, 8);
}

uint64_t pfwd_whole_as_f64(uint32_t value)
{
    if (value == 0) {
        return 0;
    }
    unsigned high = 31;
    while ((value >> high) == 0) {
        high--;
    }
    const uint64_t fraction = ((uint64_t)value << (52u - high)) & 0xFFFFFFFFFFFFFu;
    return ((uint64_t)(1023u + high) << 52) | fraction;
}

uint32_t pfwd_milli_as_f32(int32_t value)
{
    if (value == 0) {
        return 0;
    }
    const uint32_t sign = value < 0 ? 0x80000000u : 0u;
    const uint64_t size = value < 0 ? (uint64_t)(-(int64_t)value) : (uint64_t)value;
    /* 24 bits of size / 1000: scaled until the quotient has 25, then rounded. */
    uint64_t scaled = size << 20;
    int exponent = -20;
    while (scaled / 1000u >= (1u << 25)) {
        scaled >>= 1;
        exponent++;
    }
    while (scaled / 1000u < (1u << 24)) {
        scaled <<= 1;
        exponent--;
    }
    uint64_t mantissa = (scaled / 1000u + 1u) >> 1;
    exponent++;
    if (mantissa == (1u << 24)) {
        mantissa >>= 1;
        exponent++;
    }
    return sign | ((uint32_t)(exponent + 23 + 127) << 23) | ((uint32_t)mantissa & 0x7FFFFFu);
}

bool pfwd_f64_as_milli(uint64_t bits, uint64_t *milli)
{
    const unsigned exponent = (unsigned)((bits >> 52) & 0x7FFu);
    const uint64_t mantissa = (bits & 0xFFFFFFFFFFFFFu) | 0x10000000000000u;
    if ((bits >> 63) != 0 || exponent == 0 || exponent >= 1023u + 32u) {
        return false; /* negative, 0 or next to it, NaN, infinite, or more than anything samples */
    }
    if (exponent < 1023u - 10u) { /* below a thousandth */
        *milli = 1;
        return true;
    }
    /* value = mantissa * 2^(exponent - 1075); ten bits are given up for the factor of a thousand */
    const unsigned shift = 1075u - 10u - exponent;
    *milli = ((mantissa >> 10) * 1000u) >> shift;
    if (*milli == 0) {
        *milli = 1;
    }
    return true;
}

void pfwd_put_count(uint8_t *at, int32_t value)
{
    const uint32_t bits = (uint32_t)value;
    at[0] = (uint8_t)(bits & 0xFFu);
    at[1] = (uint8_t)((bits >> 8) & 0xFFu);
    at[2] = (uint8_t)((bits >> 16) & 0xFFu);
}

int32_t pfwd_get_count(const uint8_t *at)
{
    const uint32_t bits = (uint32_t)at[0] | ((uint32_t)at[1] << 8) | ((uint32_t)at[2] << 16);
    return (int32_t)(bits ^ 0x800000u) - 0x800000;
}

void pfwd_copy_bytes(uint8_t *to, const uint8_t *from, size_t size)
{
    for (size_t i = 0; i < size; i++) {
        to[i] = from[i];
    }
}
