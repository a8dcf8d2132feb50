/* One sample as palpate's tracker frame; the format is told in experiment/apparatus/frames.py. */
#ifndef PALPATE_FRAME_H
#define PALPATE_FRAME_H

#include <stdint.h>

#define FRAME_BYTES 12

void frame_encode(uint8_t frame[FRAME_BYTES], uint16_t sequence, uint32_t device_us, uint16_t counts);

#endif
