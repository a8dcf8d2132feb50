#include "frame.h"

#define BODY_BYTES 10

/* CRC-16/IBM-3740 by one byte. Folding the polynomial x^16 + x^12 + x^5 + 1 into shifts takes no table. */
static uint16_t crc_of(uint16_t crc, uint8_t byte)
{
    uint8_t x = (uint8_t)((crc >> 8) ^ byte);
    x = (uint8_t)(x ^ (x >> 4));
    return (uint16_t)((uint16_t)(crc << 8) ^ (uint16_t)((uint16_t)x << 12) ^ (uint16_t)((uint16_t)x << 5) ^ x);
}

void frame_encode(uint8_t frame[FRAME_BYTES], uint16_t sequence, uint32_t device_us, uint16_t counts)
{
    uint8_t *body = frame + 1;
    body[0] = (uint8_t)sequence;
    body[1] = (uint8_t)(sequence >> 8);
    body[2] = (uint8_t)device_us;
    body[3] = (uint8_t)(device_us >> 8);
    body[4] = (uint8_t)(device_us >> 16);
    body[5] = (uint8_t)(device_us >> 24);
    body[6] = (uint8_t)counts;
    body[7] = (uint8_t)(counts >> 8);
    uint16_t crc = 0xFFFF;
    for (uint8_t i = 0; i < 8; i++)
        crc = crc_of(crc, body[i]);
    body[8] = (uint8_t)crc;
    body[9] = (uint8_t)(crc >> 8);

    /* COBS in place: each zero, and the byte before the body, becomes the distance to the next zero. */
    uint8_t mark = 0;
    for (uint8_t i = 1; i <= BODY_BYTES; i++) {
        if (frame[i] == 0) {
            frame[mark] = (uint8_t)(i - mark);
            mark = i;
        }
    }
    frame[mark] = (uint8_t)(BODY_BYTES + 1 - mark);
    frame[BODY_BYTES + 1] = 0;
}
