#include "passage.h"

uint32_t passage_step(struct passage *passage, const struct gate *gate, uint32_t device_us, uint16_t counts)
{
    uint16_t above = passage->counts;
    uint32_t since_us = device_us - passage->device_us;
    bool begun = passage->begun;
    passage->begun = true;
    passage->counts = counts;
    passage->device_us = device_us;
    if (!begun || counts >= above)
        return 0;

    uint16_t fall = above - counts;
    if (above > gate->top && counts <= gate->top) {
        passage->top_us = device_us - since_us * (uint16_t)(gate->top - counts) / fall;
        passage->in_gate = true;
    }
    if (passage->in_gate && above > gate->bottom && counts <= gate->bottom) {
        passage->in_gate = false;
        return device_us - since_us * (uint16_t)(gate->bottom - counts) / fall - passage->top_us;
    }
    return 0;
}
