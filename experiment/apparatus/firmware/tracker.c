/* The firmware of palpate's tracker, for an ATmega328P: a potentiometer on ADC0, frames on USART0, a lamp on PB0.
 *
 * Timer 1 counts CPU cycles and starts over every period; its compare match B starts each conversion in hardware, so the
 * sampling period is exact and no program can delay it. The device's clock is the number of periods since the start,
 * in microseconds: it is read off no counter, and cannot drift against the sequence number.
 *
 * Interrupts only move data: the converter's puts a sample into a ring, the line's takes a byte from another. Between
 * them the main loop makes frames, decides about the lamp, and sleeps. Where a ring is full the whole sample is left
 * out; its sequence number is spent, so the reader counts it as lost. */

#include <avr/cpufunc.h>
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <stdbool.h>
#include <stdint.h>

#include "frame.h"
#include "passage.h"
#include "settings.h"

#define PERIOD_US (1000000UL / RATE_HZ)
#define PERIOD_CYCLES (F_CPU / RATE_HZ)
#define LONGEST_US (GATE_MM * 1000000UL / LAMP_SLOWEST_MM_S)
#define SHORTEST_US (GATE_MM * 1000000UL / LAMP_FASTEST_MM_S)
#define LAMP_US (LAMP_MS * 1000UL)

#define SAMPLES 16 /* a power of two */
#define LINE_BYTES 256 /* as many as a byte can number, so that indices wrap by themselves */

#define LINE_ON (_BV(TXEN0) | _BV(UDRIE0))
#define LINE_IDLE _BV(TXEN0)

struct sample {
    uint32_t device_us;
    uint16_t sequence;
    uint16_t counts;
};

/* Each index is one byte with one writer, so reading it needs no lock. */
static struct sample samples[SAMPLES];
static volatile uint8_t samples_in, samples_out;
static uint8_t line[LINE_BYTES];
static volatile uint8_t line_in, line_out;

ISR(ADC_vect)
{
    static uint32_t device_us = CLOCK_START_US;
    static uint16_t sequence;

    TIFR1 = _BV(OCF1B); /* the next match triggers by the flag's rising edge */
    uint8_t next = (samples_in + 1) % SAMPLES;
    if (next != samples_out) {
        samples[samples_in] = (struct sample){device_us, sequence, ADC};
        samples_in = next;
    }
    device_us += PERIOD_US;
    sequence++;
}

ISR(USART_UDRE_vect)
{
    if (line_out == line_in)
        UCSR0B = LINE_IDLE;
    else
        UDR0 = line[line_out++];
}

static void send(const struct sample *sample)
{
    uint8_t frame[FRAME_BYTES];

    if ((uint8_t)(line_in - line_out) >= LINE_BYTES - FRAME_BYTES)
        return;
    frame_encode(frame, sample->sequence, sample->device_us, sample->counts);
    uint8_t in = line_in;
    for (uint8_t i = 0; i < FRAME_BYTES; i++)
        line[in++] = frame[i];
    _MemoryBarrier(); /* the bytes stand before the index says so */
    line_in = in;
    UCSR0B = LINE_ON;
}

static uint16_t rising(uint16_t counts)
{
    return GATE_TOP_COUNTS > GATE_BOTTOM_COUNTS ? counts : CONVERTER_MAX - counts;
}

static void light(const struct sample *sample)
{
    static struct passage passage;
    static uint32_t lit_us;
    const struct gate gate = {rising(GATE_TOP_COUNTS), rising(GATE_BOTTOM_COUNTS)};

    uint32_t took_us = passage_step(&passage, &gate, sample->device_us, rising(sample->counts));
    if (took_us >= SHORTEST_US && took_us <= LONGEST_US) {
        lit_us = sample->device_us;
        PORTB |= _BV(PORTB0);
    } else if (took_us != 0 || sample->device_us - lit_us >= LAMP_US) {
        PORTB &= (uint8_t)~_BV(PORTB0);
    }
}

static void start(void)
{
    DDRB = _BV(DDB0);

    UCSR0A = _BV(U2X0);
    UBRR0 = F_CPU / (8UL * BAUD) - 1;
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = LINE_IDLE;

    /* The supply is the reference, as it is the potentiometer's. 16 MHz / 128 = 125 kHz: full resolution needs 50 to
     * 200 kHz. The first conversion after switching on takes longer and is thrown away. */
    DIDR0 = _BV(ADC0D);
    ADMUX = _BV(REFS0);
    ADCSRA = _BV(ADEN) | _BV(ADSC) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);
    loop_until_bit_is_clear(ADCSRA, ADSC);
    ADCSRB = _BV(ADTS2) | _BV(ADTS0);
    ADCSRA = _BV(ADEN) | _BV(ADATE) | _BV(ADIF) | _BV(ADIE) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);

    OCR1A = PERIOD_CYCLES - 1;
    OCR1B = PERIOD_CYCLES - 1;
    TCCR1B = _BV(WGM12) | _BV(CS10);
}

int main(void)
{
    start();
    set_sleep_mode(SLEEP_MODE_IDLE);
    sleep_enable();
    for (;;) {
        /* An interrupt that comes after the look still ends the sleep: sei takes effect one instruction later. */
        cli();
        if (samples_out == samples_in) {
            sei();
            sleep_cpu();
            continue;
        }
        sei();
        struct sample sample = samples[samples_out];
        _MemoryBarrier(); /* the place is given back after it was read */
        samples_out = (samples_out + 1) % SAMPLES;
        send(&sample);
        light(&sample);
    }
}
