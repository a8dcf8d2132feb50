/* A test tool: runs the tracker's firmware in simavr, between a moving potentiometer and a pseudo-terminal.
 *
 * Copyright (C) 2026 The palpate developers
 * SPDX-License-Identifier: GPL-3.0-or-later
 *
 * This program is free software: you can redistribute it and/or modify it under the terms of the GNU General Public
 * License as published by the Free Software Foundation, either version 3 of the License, or (at your option) any later
 * version. It is distributed in the hope that it will be useful, but WITHOUT ANY WARRANTY; without even the implied
 * warranty of MERCHANTABILITY or FITNESS FOR A PARTICULAR PURPOSE. See <https://www.gnu.org/licenses/>.
 *
 * It links simavr, which is under the same licence. It is no part of palpate's wheel; the firmware that it runs and the
 * rest of palpate stand under palpate's own licence.
 *
 *     simavr_host FIRMWARE.elf TRAJECTORY EVENTS CYCLES
 *
 * TRAJECTORY: lines "cycle millivolts", cycles rising; straight lines between them, ADC0 sees the nearest millivolt.
 * EVENTS: is written: "convert CYCLE MILLIVOLTS" where a conversion starts, "lamp CYCLE LEVEL" where PB0 changes, and
 * "asleep CYCLES" at the end.
 *
 * It prints "port NAME" of the pseudo-terminal (simavr prints lines of its own), waits for a line on standard
 * input, runs CYCLES cycles as fast as whoever reads the terminal takes the bytes, prints "done", and hangs up when
 * standard input ends.
 *
 * What simavr 1.6 lacks is done here: a compare match B of timer 1 starts a conversion where the flag OCF1B rises, as
 * the converter's auto trigger does, and not where it stands already. */

#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <math.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <unistd.h>

#include <simavr/avr_adc.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <simavr/sim_interrupts.h>

#define TIMER1_COMPB_VECTOR 12
#define FREQUENCY_HZ 16000000
#define SUPPLY_MV 5000
#define PENDING 4096

static avr_t *avr;
static FILE *events;
static double *knot_cycles, *knot_mv;
static size_t knots, knot;
static int line_fd;
static uint8_t pending[PENDING];
static size_t pending_bytes;
static uint64_t asleep_cycles;

static void fail(const char *what)
{
    fprintf(stderr, "simavr_host: %s: %s\n", what, strerror(errno));
    exit(1);
}

static void read_trajectory(const char *path)
{
    FILE *file = fopen(path, "r");
    if (!file)
        fail(path);
    double cycle, mv;
    while (fscanf(file, "%lf %lf", &cycle, &mv) == 2) {
        knot_cycles = realloc(knot_cycles, (knots + 1) * sizeof *knot_cycles);
        knot_mv = realloc(knot_mv, (knots + 1) * sizeof *knot_mv);
        if (!knot_cycles || !knot_mv)
            fail("trajectory");
        knot_cycles[knots] = cycle;
        knot_mv[knots++] = mv;
    }
    fclose(file);
    if (!knots) {
        errno = EINVAL;
        fail(path);
    }
}

static uint32_t wiper_mv(double cycle)
{
    while (knot + 1 < knots && knot_cycles[knot + 1] <= cycle)
        knot++;
    if (cycle <= knot_cycles[knot] || knot + 1 == knots)
        return (uint32_t)lround(knot_mv[knot]);
    double part = (cycle - knot_cycles[knot]) / (knot_cycles[knot + 1] - knot_cycles[knot]);
    return (uint32_t)lround(knot_mv[knot] + part * (knot_mv[knot + 1] - knot_mv[knot]));
}

static void flush_line(void)
{
    size_t sent = 0;
    while (sent < pending_bytes) {
        ssize_t taken = write(line_fd, pending + sent, pending_bytes - sent);
        if (taken > 0) {
            sent += (size_t)taken;
        } else if (errno == EAGAIN) {
            struct pollfd room = {line_fd, POLLOUT, 0};
            poll(&room, 1, 100);
        } else if (errno != EINTR) {
            fail("pseudo-terminal");
        }
    }
    pending_bytes = 0;
}

static void on_byte(struct avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq, (void)param;
    pending[pending_bytes++] = (uint8_t)value;
    if (value == 0 || pending_bytes == PENDING)
        flush_line();
}

static void on_conversion(struct avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq, (void)value, (void)param;
    uint32_t mv = wiper_mv((double)avr->cycle);
    avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0), mv);
    fprintf(events, "convert %" PRIu64 " %" PRIu32 "\n", avr->cycle, mv);
}

static void on_match(struct avr_irq_t *irq, uint32_t value, void *param)
{
    (void)param;
    if (value && !irq->value)
        avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_IN_TRIGGER), 1);
}

static void on_lamp(struct avr_irq_t *irq, uint32_t value, void *param)
{
    (void)param;
    if (value != irq->value)
        fprintf(events, "lamp %" PRIu64 " %" PRIu32 "\n", avr->cycle, value);
}

static void on_sleep(avr_t *sleeper, avr_cycle_count_t cycles)
{
    (void)sleeper;
    asleep_cycles += cycles;
}

static const char *open_line(void)
{
    line_fd = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
    if (line_fd < 0 || grantpt(line_fd) || unlockpt(line_fd))
        fail("pseudo-terminal");
    const char *name = ptsname(line_fd);
    /* Held open, so that the line keeps raw mode before and after each reader. */
    int port = name ? open(name, O_RDWR | O_NOCTTY) : -1;
    struct termios mode;
    if (port < 0 || tcgetattr(port, &mode))
        fail("pseudo-terminal");
    cfmakeraw(&mode);
    if (tcsetattr(port, TCSANOW, &mode))
        fail("pseudo-terminal");
    return name;
}

static void load(const char *path)
{
    elf_firmware_t firmware = {0};
    if (elf_read_firmware(path, &firmware)) {
        errno = ENOEXEC;
        fail(path);
    }
    avr = avr_make_mcu_by_name("atmega328p");
    if (!avr) {
        errno = ENODEV;
        fail("atmega328p");
    }
    avr_init(avr);
    firmware.frequency = FREQUENCY_HZ;
    avr_load_firmware(avr, &firmware);
    avr->vcc = avr->avcc = avr->aref = SUPPLY_MV;
    avr->sleep = on_sleep;

    uint32_t uart_flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &uart_flags);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_byte, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_OUT_TRIGGER), on_conversion, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), IOPORT_IRQ_PIN0), on_lamp, NULL);
    avr_irq_t *match = avr_get_interrupt_irq(avr, TIMER1_COMPB_VECTOR);
    avr_irq_register_notify(match + AVR_INT_IRQ_PENDING, on_match, NULL);
}

int main(int argc, char **argv)
{
    if (argc != 5) {
        fprintf(stderr, "usage: simavr_host FIRMWARE.elf TRAJECTORY EVENTS CYCLES\n");
        return 2;
    }
    read_trajectory(argv[2]);
    events = fopen(argv[3], "w");
    if (!events)
        fail(argv[3]);
    uint64_t last = strtoull(argv[4], NULL, 10);
    load(argv[1]);
    printf("port %s\n", open_line());
    fflush(stdout);
    if (getchar() == EOF)
        return 0;

    while (avr->cycle < last) {
        int state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed) {
            errno = EFAULT;
            fail("firmware");
        }
    }
    flush_line();
    fprintf(events, "asleep %" PRIu64 "\n", asleep_cycles);
    fclose(events);
    printf("done\n");
    fflush(stdout);
    while (getchar() != EOF)
        continue;
    return 0;
}
