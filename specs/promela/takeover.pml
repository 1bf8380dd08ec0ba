/*
 * Work-coupled take-over, one way, in discrete time (§2; D30, D61): a primary with a lease, a standby.
 *
 * Written from specs/decisions/requirements.md and machine.md, not from the Rust.
 *
 *   L           the lease, in ticks                 T   the standby takes over T ticks after the last answer it took
 *   D           a packet is on the way 0..D ticks   E   the standby sends a beat every E ticks
 *   DRIFT       how many ticks the two clocks may together go wrong, over the whole run
 *   LOSS        packets that may be lost at most; not given: without limit
 *   HEARTBEAT   the variant: no echo, any beat renews the lease for L from its arrival
 *   one other question in the place of the property:
 *     RENEWED   fails when a lease can be renewed (else the property would hold of nothing)
 *     TAKEN     fails when the standby can take over
 *     STAYS     with LOSS and DRIFT 0: the primary is never fenced while it is in touch
 *
 * Rules
 *   Primary: holds a lease until some instant of its own clock. A beat that echoes answer k makes it
 *     max(lease, instant at which k was sent + L), by its own clock. It answers each beat at once. It is fenced when its clock
 *     reaches the end of the lease; from then on it is passive for ever and answers nothing.
 *   Standby: sends a beat every E ticks of its own clock with the number of the newest answer it has. An answer older than
 *     the newest one is ignored. When its clock is T past the arrival of the newest answer it takes over: active for ever, and it
 *     sends no more beats.
 *   At time 0 the primary has just sent an answer and the standby has just taken it; the first beat goes at E.
 *
 * What a tick is. Packets and both nodes live in true time, which goes in ticks. One step TICK(p, s) is, in this order:
 *     1. every packet on the way is one tick older; none may be older than D (it must have arrived or been lost before);
 *     2. the primary's clock goes on by p and the standby's by s; p = s = 1 costs nothing, each tick more or less costs one of DRIFT;
 *     3. the primary is fenced if now >= end of lease (both nodes act on their clocks before any packet of this instant arrives);
 *     4. the standby takes over if now >= arrival of the newest answer + T; otherwise, if a beat is due, it sends it;
 *     5. the property is looked at.
 *   Between ticks packets arrive one by one in any order, those just sent included (a way of 0 ticks). What a node sends in
 *   reaction to a packet leaves in the same step. A packet to be lost vanishes when it is D ticks old: before, nobody can tell.
 *   A timer that comes late by a tick, or a node that stands still for a tick, is one of DRIFT: its clock as the node acts on it.
 *
 * Property: never are both active.
 * The run ends when the primary is fenced: it stays so, and the property with it.
 *
 * Numbers of answers are not kept: with each answer, echo and beat goes how long ago, on the primary's clock, that answer was
 * sent, up to L. What is L old renews nothing.
 */

#ifndef L
#define L 6
#endif
#ifndef T
#define T 6
#endif
#ifndef D
#define D 1
#endif
#ifndef E
#define E 2
#endif
#ifndef DRIFT
#define DRIFT 0
#endif

#if E < 1 || L < 1
#error "a beat every tick at most, and a lease of a tick at least"
#endif

/* How many packets can be on the way: a beat every E ticks (one more if a clock runs ahead), an answer to each. */
#define BEATS   (D / E + 2 + DRIFT)
#define ANSWERS (2 * D / E + 3 + DRIFT)
#define FREE    255
#if BEATS > 6 || ANSWERS > 8
#error "more packets on the way than this model has room for"
#endif

byte lease = L;            /* ticks left on the primary's clock; 0: fenced */
byte silent;               /* ticks on the standby's clock since the newest answer arrived */
bool taken;                /* the standby has taken over */
byte echo;                 /* age, on the primary's clock, of the newest answer that the standby has */
byte beat_in = E;          /* ticks on the standby's clock until it sends a beat */
byte overdue;              /* packets that are D ticks old */
byte drift;                /* how much the clocks went wrong so far */
#ifdef LOSS
byte lost;
#endif

byte beat_way[BEATS] = FREE;      /* how many ticks a beat has been on the way */
byte beat_echo[BEATS];            /* the age of the answer it echoes, on the primary's clock */
byte answer_way[ANSWERS] = FREE;
byte answer_age[ANSWERS];         /* the age of the answer, on the primary's clock */

hidden byte i, place;

/* Adds to an age; what is L old stays so. */
#define AGE(age, by)    age = age + by; if :: age > L -> age = L :: else fi

inline send_beat()
{
    place = 0;
    do
    :: beat_way[place] != FREE -> place++; assert(place < BEATS)
    :: else -> break
    od;
    beat_way[place] = 0;
#ifndef HEARTBEAT
    beat_echo[place] = echo
#endif
}

inline send_answer()
{
    place = 0;
    do
    :: answer_way[place] != FREE -> place++; assert(place < ANSWERS)
    :: else -> break
    od;
    answer_way[place] = 0;
    answer_age[place] = 0
}

inline renew(left)
{
    if
    :: left > lease ->
#ifdef RENEWED
        assert(false);
#endif
        lease = left
    :: else
    fi
}

inline beat_arrives(k)
{
#ifdef HEARTBEAT
    renew(L);
#else
    renew(L - beat_echo[k]);
#endif
    beat_way[k] = FREE; beat_echo[k] = 0;
    send_answer()
}

inline answer_arrives(k)
{
    if
    :: answer_age[k] <= echo -> echo = answer_age[k]; silent = 0
    :: else
    fi;
    answer_way[k] = FREE; answer_age[k] = 0
}

inline older(p)
{
    for (i : 0 .. BEATS - 1) {
        if
        :: beat_way[i] != FREE -> beat_way[i]++;
#ifndef HEARTBEAT
            AGE(beat_echo[i], p)
#endif
        :: else
        fi
    }
    for (i : 0 .. ANSWERS - 1) {
        if
        :: answer_way[i] != FREE -> answer_way[i]++; AGE(answer_age[i], p)
        :: else
        fi
    }
    AGE(echo, p)
}

inline judge()
{
#if defined(RENEWED)
    skip
#elif defined(TAKEN)
    assert(!taken)
#elif defined(STAYS)
    assert(lease > 0)
#else
    assert(!(lease > 0 && taken))
#endif
}

inline tick(p, s)
{
    older(p);
    if
    :: lease > p -> lease = lease - p
    :: else -> lease = 0
    fi;
    silent = silent + s;
    if
    :: silent >= T -> taken = true
    :: else ->
        if
        :: beat_in <= s -> beat_in = E; send_beat()
        :: else -> beat_in = beat_in - s
        fi
    fi;
    judge()
}

/* How many packets are D ticks old: time stands still until they have arrived or vanished. */
inline count_overdue()
{
    overdue = 0;
    for (i : 0 .. BEATS - 1) {
        overdue = overdue + (beat_way[i] == D)
    }
    for (i : 0 .. ANSWERS - 1) {
        overdue = overdue + (answer_way[i] == D)
    }
    skip
}

#ifdef LOSS
#define MAY_LOSE   lost < LOSS
#define COUNT_LOSS lost++
#else
#define MAY_LOSE   true
#define COUNT_LOSS skip
#endif

/* Once the primary is fenced nothing can go wrong any more, and nothing more happens. */
#define GOES_ON (lease > 0 && !taken)

#define TICK(p, s, cost) \
    :: d_step { GOES_ON && overdue == 0 && drift + cost <= DRIFT -> \
        drift = drift + cost; tick(p, s); count_overdue() }

#define BEAT(k) \
    :: d_step { GOES_ON && beat_way[k] != FREE -> beat_arrives(k); count_overdue() } \
    :: d_step { GOES_ON && beat_way[k] == D && MAY_LOSE -> \
        COUNT_LOSS; beat_way[k] = FREE; beat_echo[k] = 0; overdue-- }

#define ANSWER(k) \
    :: d_step { GOES_ON && answer_way[k] != FREE -> answer_arrives(k); count_overdue() } \
    :: d_step { GOES_ON && answer_way[k] == D && MAY_LOSE -> \
        COUNT_LOSS; answer_way[k] = FREE; answer_age[k] = 0; overdue-- }

active proctype world()
{
end:
    do
    TICK(1, 1, 0) TICK(0, 1, 1) TICK(2, 1, 1) TICK(1, 0, 1) TICK(1, 2, 1)
    TICK(0, 0, 2) TICK(0, 2, 2) TICK(2, 0, 2) TICK(2, 2, 2)
    BEAT(0) BEAT(1)
#if BEATS > 2
    BEAT(2)
#endif
#if BEATS > 3
    BEAT(3)
#endif
#if BEATS > 4
    BEAT(4)
#endif
#if BEATS > 5
    BEAT(5)
#endif
    ANSWER(0) ANSWER(1) ANSWER(2)
#if ANSWERS > 3
    ANSWER(3)
#endif
#if ANSWERS > 4
    ANSWER(4)
#endif
#if ANSWERS > 5
    ANSWER(5)
#endif
#if ANSWERS > 6
    ANSWER(6)
#endif
#if ANSWERS > 7
    ANSWER(7)
#endif
    od
}
