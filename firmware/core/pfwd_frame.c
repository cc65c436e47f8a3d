/* Frames: COBS with a closing zero, a counter and a CRC. */
#include "pfwd_internal.h"

#define LONGEST_FRAME 8192u
#define SHORTEST_PACKET 7u

uint32_t pfwd_frame(uint8_t *frame, uint8_t *packet, uint32_t payload, uint8_t type,
                    uint16_t counter)
{
    /* The payload stands at packet + 3 already. */
    packet[0] = type;
    pfwd_put(packet + 1, counter, 2);
    uint32_t crc = pfwd_crc(0, packet, payload + 3u);
    if (PFWD_PLANTED(1)) {
        crc ^= 1u;
    }
    pfwd_put(packet + 3u + payload, crc, 4);
    const uint32_t size = payload + SHORTEST_PACKET;
    uint32_t code_at = 0;
    uint32_t out = 1;
    uint8_t code = 1;
    for (uint32_t i = 0; i < size; i++) {
        if (packet[i] != 0) {
            frame[out++] = packet[i];
            code++;
        }
        if (packet[i] == 0 || (code == 255u && i + 1u < size)) {
            frame[code_at] = code;
            code_at = out++;
            code = 1;
        }
    }
    frame[code_at] = code;
    frame[out++] = 0;
    return out;
}

void pfwd_deframer_reset(pfwd_deframer *in)
{
    in->crc = 0;
    in->size = 0;
    in->encoded = 0;
    in->left = 0;
    in->zero_due = false;
    in->bad = false;
}

static void take(pfwd_deframer *in, uint8_t byte)
{
    if (in->size < PFWD_KEPT_BYTES) {
        in->kept[in->size] = byte;
    }
    in->size++;
    in->crc = pfwd_crc(in->crc, &byte, 1);
}

bool pfwd_deframe(pfwd_deframer *in, uint8_t byte)
{
    if (in->encoded == 0) {
        pfwd_deframer_reset(in); /* `kept` of the last packet is not needed any more */
    }
    if (byte == 0) {
        const bool whole = in->encoded > 0 && !in->bad && in->left == 0 &&
                           in->size >= SHORTEST_PACKET && in->crc == PFWD_CRC_RESIDUE;
        if (PFWD_PLANTED(16) && !whole && in->encoded > 0) {
            return false; /* never finds the next frame after noise */
        }
        in->encoded = 0;
        return whole;
    }
    in->encoded++;
    if (in->encoded > LONGEST_FRAME) {
        in->encoded = LONGEST_FRAME;
        in->bad = true;
        return false;
    }
    if (in->left > 0) {
        in->left--;
        take(in, byte);
        return false;
    }
    if (in->zero_due) {
        take(in, 0);
    }
    in->zero_due = byte != 0xFFu;
    in->left = (uint8_t)(byte - 1u);
    return false;
}
