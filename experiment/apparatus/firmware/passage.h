/* How long a foot took through the gate, from the sensor's counts. It serves the lamp alone: the speed that counts is
 * computed by experiment/apparatus/gate.py from the frames. */
#ifndef PALPATE_PASSAGE_H
#define PALPATE_PASSAGE_H

#include <stdbool.h>
#include <stdint.h>

struct gate {
    uint16_t top; /* counts, more than bottom */
    uint16_t bottom;
};

struct passage {
    bool begun;         /* a sample was seen */
    bool in_gate;       /* the top was crossed downward, the bottom not yet */
    uint16_t counts;    /* of the last sample */
    uint32_t device_us; /* of the last sample */
    uint32_t top_us;    /* when the top was crossed */
};

/* Take the next sample: counts that rise with height, and less than 2^16 us after the sample before. Returns the time
 * from the last downward crossing of the top to the first of the bottom after it, in us, when that has just ended;
 * else 0. Crossings lie on the straight line between two samples. */
uint32_t passage_step(struct passage *passage, const struct gate *gate, uint32_t device_us, uint16_t counts);

#endif
