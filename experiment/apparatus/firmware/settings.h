/* What a laboratory chooses, by `make NAME=value`; see README.md. */
#ifndef PALPATE_SETTINGS_H
#define PALPATE_SETTINGS_H

#ifndef RATE_HZ
#define RATE_HZ 1000
#endif

#ifndef BAUD
#define BAUD 1000000
#endif

/* The reading at 20 mm and at 10 mm above the panel; counts may rise or fall with height. */
#ifndef GATE_TOP_COUNTS
#define GATE_TOP_COUNTS 246
#endif
#ifndef GATE_BOTTOM_COUNTS
#define GATE_BOTTOM_COUNTS 164
#endif

/* The lamp is lit for LAMP_MS after a step between these speeds. */
#ifndef LAMP_SLOWEST_MM_S
#define LAMP_SLOWEST_MM_S 180
#endif
#ifndef LAMP_FASTEST_MM_S
#define LAMP_FASTEST_MM_S 220
#endif
#ifndef LAMP_MS
#define LAMP_MS 1000
#endif

/* The clock of the first sample; a test starts it just before it wraps. */
#ifndef CLOCK_START_US
#define CLOCK_START_US 0
#endif

#define CONVERTER_MAX 1023
#define GATE_MM 10
#define FRAME_LINE_BITS 120

#if RATE_HZ < 1000 || RATE_HZ > 5000 || 1000000 % RATE_HZ
#error "RATE_HZ: allowed are 1000, 1250, 1600, 2000, 2500, 3125, 4000 and 5000; the period is whole microseconds"
#endif
#if F_CPU % 1000000 || F_CPU < 2000 * RATE_HZ || F_CPU > 25000000
#error "F_CPU: allowed are whole megahertz up to 25, at least 2000 cycles a sample: a conversion takes 1731"
#endif
#if F_CPU % (8 * BAUD)
#error "BAUD: allowed is what divides F_CPU / 8, so that the line's speed is exact"
#endif
#if BAUD < FRAME_LINE_BITS * RATE_HZ
#error "BAUD: at least 120 times RATE_HZ, because a frame takes 120 bits"
#endif
#if GATE_TOP_COUNTS == GATE_BOTTOM_COUNTS || GATE_TOP_COUNTS < 0 || GATE_TOP_COUNTS > CONVERTER_MAX || \
    GATE_BOTTOM_COUNTS < 0 || GATE_BOTTOM_COUNTS > CONVERTER_MAX
#error "GATE_TOP_COUNTS, GATE_BOTTOM_COUNTS: allowed are two different readings from 0 to 1023"
#endif
#if LAMP_SLOWEST_MM_S < 1 || LAMP_FASTEST_MM_S < LAMP_SLOWEST_MM_S
#error "LAMP_SLOWEST_MM_S, LAMP_FASTEST_MM_S: at least 1 mm/s, and the second no less than the first"
#endif
#if LAMP_MS < 1 || LAMP_MS > 60000
#error "LAMP_MS: allowed are 1 to 60000 ms"
#endif

#endif
