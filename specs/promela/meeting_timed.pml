/*
 * waitfor in discrete time: time_outs, re-sending, give-ups, the margin (§4.3; D2, D54 to D56). One attempt each.
 *
 * Written from specs/decisions/machine.md, not from the Rust. It is there to be measured beside the checker at equal bounds
 * (`model/benches/twin.rs`), and its verdicts are compared (`tests/twins.rs`).
 *
 *   N         2..3 members                     T         time_out of each, in ticks (at most 15)
 *   D         a packet is on the way 0..D ticks (at most 3)
 *   RESEND    ARRIVE is repeated when the time left is a multiple of this
 *   COPIES    a CONFIRM is sent so many times more, RESEND apart
 *   MARGIN    release on all arrivals only if more than this is left of each
 *   LOSS      packets that may be lost at most
 *   HURRY     no time passes before everybody has reached the waitfor
 *   FORGET    a packet that changes nothing wherever and whenever it arrives vanishes at once
 *
 * What a tick is: every packet on the way is a tick older (none may be older than D); every wait, arrival and copy has a tick
 * less; who has no time left gives up, what is due is sent. Between ticks members reach the waitfor, whenever they like or
 * never, and packets arrive, one by one in any order. A packet to be lost vanishes when it is D ticks old.
 *
 * Rules
 *   Reaching the waitfor announces round max(1, freshest round heard of) with ARRIVE(round, time left) to every other member.
 *   Link charge: what arrives has D less left than when it was sent. Of two copies the one with more time left counts.
 *   Release: every other member's arrival of this round is held, each with more than MARGIN left; or CONFIRM(round).
 *   CONFIRM: sent to all by who holds all arrivals, one that a CONFIRM released before included.
 *   Giving up: ABORT(round, next = round + 1) to all.
 *   ABORT(r, next) erases its sender's arrival up to r and bars later copies; who waits in r or before goes on to round next.
 *   ARRIVE of a fresher round: who waits goes on to it. Of the round that one was released from: CONFIRM back. Of another round
 *   that one is no longer in: ABORT back.
 * Left out: a member that has released does not come again, so no ARRIVE says that its sender released something.
 *
 * Property (D2): no round from which one member was released is left by another without a release.
 * When everybody has ended, nothing more can be seen, and the run ends.
 */

#ifndef N
#define N 2
#endif
#ifndef T
#define T 5
#endif
#ifndef D
#define D 1
#endif
#ifndef RESEND
#define RESEND 2
#endif
#ifndef COPIES
#define COPIES 1
#endif
#ifndef MARGIN
#define MARGIN 3
#endif
#ifndef LOSS
#define LOSS 1
#endif
#ifndef ROOM
#define ROOM 14
#endif

#define AWAY     0
#define WAITS    1
#define RELEASED 2
#define GAVE_UP  3

#define ARRIVE   1
#define CONFIRM  2
#define ABORT    3

byte state[N];          /* AWAY, WAITS, RELEASED, GAVE_UP */
byte round[N];          /* the last round announced; AWAY: the freshest heard of */
byte left[N];           /* ticks until it gives up */
byte copies[N];         /* CONFIRMs still to be sent */
byte copy_in[N];        /* ticks until the next */
bool owes[N];           /* released by a CONFIRM, has not held all arrivals yet */
byte a_round[N * N];    /* [i * N + j]: the round of j's arrival that i holds; 0: none */
byte a_left[N * N];     /* what is left of it */
byte barred[N * N];     /* rounds of j that count for nothing any more, up to this one */
byte released_from;     /* bit r: somebody was released from round r */
byte left_alone;        /* bit r: somebody left round r without a release */
byte lost;

/* Packets on the way, sorted: kind, from, to and age in one byte, round and time left (or next round) in the other. */
byte head[ROOM];
byte body[ROOM];
byte on_the_way;

hidden byte i, j, k, q, r, x, from, to, kind, least, h, b;
hidden byte all;

#define BIT(n)      (1 << (n))
#define HEAD(k, f, t) (((k) << 6) | ((f) << 4) | ((t) << 2))

inline put(hd, bd)
{
    h = hd; b = bd;
    assert(on_the_way < ROOM);
    k = on_the_way;
    do
    :: k > 0 && (head[k - 1] > h || (head[k - 1] == h && body[k - 1] > b)) ->
        head[k] = head[k - 1]; body[k] = body[k - 1]; k--
    :: else -> break
    od;
    head[k] = h; body[k] = b;
    on_the_way++
}

/* To every other member. */
inline tell(knd, f, bdy)
{
    for (q : 0 .. N - 1) {
        if
        :: q != f -> put(HEAD(knd, f, q), bdy)
        :: else
        fi
    }
}

inline take_out(slot)
{
    k = slot;
    do
    :: k + 1 < on_the_way -> head[k] = head[k + 1]; body[k] = body[k + 1]; k++
    :: else -> break
    od;
    head[k] = 0; body[k] = 0;
    on_the_way--
}

/* Does m hold all arrivals of its round, and how much is left of the least? */
inline count_arrivals(m)
{
    all = true; least = 255;
    for (q : 0 .. N - 1) {
        if
        :: q != m && (a_round[m * N + q] != round[m] || a_left[m * N + q] == 0) -> all = false
        :: q != m && a_round[m * N + q] == round[m] && a_left[m * N + q] < least -> least = a_left[m * N + q]
        :: else
        fi
    }
}

inline confirm_all(m)
{
    owes[m] = false;
    tell(CONFIRM, m, round[m] << 4);
    copies[m] = COPIES;
    if
    :: COPIES > 0 -> copy_in[m] = RESEND
    :: else
    fi
}

/* m may hold all arrivals now. */
inline consider(m)
{
    count_arrivals(m);
    if
    :: all && state[m] == WAITS && least > MARGIN ->
        state[m] = RELEASED; left[m] = 0;
        released_from = released_from | BIT(round[m]);
        confirm_all(m)
    :: all && state[m] == RELEASED && owes[m] -> confirm_all(m)
    :: else
    fi
}

inline announce(m)
{
    tell(ARRIVE, m, (round[m] << 4) | left[m])
}

inline go_on(m, next)
{
    left_alone = left_alone | BIT(round[m]);
    round[m] = next;
    announce(m)
}

inline hold(m, f)
{
    if
    :: a_round[m * N + f] < r -> a_round[m * N + f] = r; a_left[m * N + f] = x
    :: a_round[m * N + f] == r && a_left[m * N + f] < x -> a_left[m * N + f] = x
    :: else
    fi
}

/* ARRIVE(r) from `from` with x left is at m. */
inline arrives(m)
{
    if
    :: x <= D || r <= barred[m * N + from]
    :: else ->
        x = x - D;
        if
        :: state[m] == AWAY ->
            if
            :: r > round[m] -> round[m] = r
            :: else
            fi;
            hold(m, from)
        :: state[m] == WAITS && r >= round[m] ->
            if
            :: r > round[m] -> go_on(m, r)
            :: else
            fi;
            hold(m, from);
            consider(m)
        :: state[m] == WAITS && r < round[m] -> put(HEAD(ABORT, m, from), (r << 4) | round[m])
        :: state[m] == RELEASED && r == round[m] ->
            hold(m, from);
            put(HEAD(CONFIRM, m, from), r << 4);
            consider(m)
        :: state[m] == RELEASED && r < round[m] -> put(HEAD(ABORT, m, from), (r << 4) | (round[m] + 1))
        :: state[m] == GAVE_UP && r <= round[m] -> put(HEAD(ABORT, m, from), (r << 4) | (round[m] + 1))
        :: else
        fi
    fi
}

inline confirmed(m)
{
    if
    :: state[m] == WAITS && r == round[m] ->
        state[m] = RELEASED; left[m] = 0;
        released_from = released_from | BIT(r);
        owes[m] = true;
        consider(m)
    :: else
    fi
}

/* ABORT(r, next x) from `from` is at m. */
inline aborted(m)
{
    if
    :: state[m] == AWAY || state[m] == WAITS ->
        if
        :: barred[m * N + from] < r -> barred[m * N + from] = r
        :: else
        fi;
        if
        :: a_round[m * N + from] <= r -> a_round[m * N + from] = 0; a_left[m * N + from] = 0
        :: else
        fi;
        if
        :: state[m] == AWAY && x > round[m] -> round[m] = x
        :: state[m] == WAITS && round[m] <= r -> go_on(m, x); consider(m)
        :: else
        fi
    :: else
    fi
}

#define BOTH_HAVE_ENDED (state[from] >= RELEASED && state[to] >= RELEASED)

/* What a member that has ended does not need is emptied, so that equal futures are equal states. */
inline tidy()
{
    for (i : 0 .. N - 1) {
        if
        :: state[i] == GAVE_UP || (state[i] == RELEASED && !owes[i]) ->
            for (j : 0 .. N - 1) {
                a_round[i * N + j] = 0; a_left[i * N + j] = 0; barred[i * N + j] = 0
            }
        :: else
        fi
    }
#ifdef FORGET
    /*
     * A CONFIRM or ABORT to who has ended. An ARRIVE with no time left, or between two that have ended: its answer would
     * change nothing (but who owes a CONFIRM may get to send it by this arrival).
     */
    i = 0;
    do
    :: i < on_the_way ->
        from = (head[i] >> 4) & 3;
        to = (head[i] >> 2) & 3;
        kind = head[i] >> 6;
        if
        :: kind != ARRIVE && state[to] >= RELEASED -> take_out(i)
        :: kind == ARRIVE && (body[i] & 15) <= D -> take_out(i)
        :: kind == ARRIVE && (body[i] & 15) > D && BOTH_HAVE_ENDED && !owes[to] -> take_out(i)
        :: else -> i++
        fi
    :: else -> break
    od;
#endif
    skip
}

inline judge()
{
    tidy();
    assert(!(released_from & left_alone))
}

inline tick()
{
    for (i : 0 .. on_the_way) {
        if
        :: i < on_the_way -> head[i]++
        :: else
        fi
    }
    for (i : 0 .. N * N - 1) {
        if
        :: a_left[i] > 1 -> a_left[i]--
        :: a_left[i] == 1 -> a_left[i] = 0; a_round[i] = 0
        :: else
        fi
    }
    for (i : 0 .. N - 1) {
        if
        :: state[i] == WAITS ->
            left[i]--;
            if
            :: left[i] == 0 ->
                state[i] = GAVE_UP;
                left_alone = left_alone | BIT(round[i]);
                tell(ABORT, i, (round[i] << 4) | (round[i] + 1))
            :: left[i] > 0 && left[i] % RESEND == 0 -> announce(i)
            :: else
            fi
        :: state[i] == RELEASED && copies[i] > 0 ->
            copy_in[i]--;
            if
            :: copy_in[i] == 0 ->
                tell(CONFIRM, i, round[i] << 4);
                copies[i]--;
                if
                :: copies[i] > 0 -> copy_in[i] = RESEND
                :: else
                fi
            :: else
            fi
        :: else
        fi
    }
    judge()
}

inline reaches(m)
{
    state[m] = WAITS;
    left[m] = T;
    if
    :: round[m] == 0 -> round[m] = 1
    :: else
    fi;
    announce(m);
    consider(m);
    judge()
}

inline deliver(slot)
{
    kind = head[slot] >> 6; from = (head[slot] >> 4) & 3; to = (head[slot] >> 2) & 3;
    r = body[slot] >> 4; x = body[slot] & 15;
    take_out(slot);
    if
    :: kind == ARRIVE -> arrives(to)
    :: kind == CONFIRM -> confirmed(to)
    :: kind == ABORT -> aborted(to)
    fi;
    judge()
}

/* A packet at the end of its way. */
#define OLD(s)  ((head[s] & 3) == D)

#if N == 2
#define ENDED (state[0] >= RELEASED && state[1] >= RELEASED)
#else
#define ENDED (state[0] >= RELEASED && state[1] >= RELEASED && state[2] >= RELEASED)
#endif

#ifndef HURRY
#define EVERYBODY_HURRIED true
#elif N == 2
#define EVERYBODY_HURRIED (state[0] != AWAY && state[1] != AWAY)
#else
#define EVERYBODY_HURRIED (state[0] != AWAY && state[1] != AWAY && state[2] != AWAY)
#endif

/* Whether time may pass: nothing is at the end of its way. */
bool may_pass = true;

inline look()
{
    may_pass = true;
    for (i : 0 .. on_the_way) {
        if
        :: i < on_the_way && OLD(i) -> may_pass = false
        :: else
        fi
    }
    skip
}

/* Of equal packets one is enough to choose. */
#define CHOICE(s, before) (s < on_the_way && !(s > 0 && head[s] == head[before] && body[s] == body[before]))

#define SLOT(s, before) \
    :: d_step { !ENDED && CHOICE(s, before) -> deliver(s); look() } \
    :: d_step { !ENDED && CHOICE(s, before) && OLD(s) && lost < LOSS -> \
        lost++; take_out(s); judge(); look() }

active proctype world()
{
end:
    do
    :: d_step { !ENDED && may_pass && EVERYBODY_HURRIED -> tick(); look() }
    :: d_step { state[0] == AWAY && !ENDED -> reaches(0); look() }
    :: d_step { state[1] == AWAY && !ENDED -> reaches(1); look() }
#if N > 2
    :: d_step { state[2] == AWAY && !ENDED -> reaches(2); look() }
#endif
    SLOT(0, 0) SLOT(1, 0) SLOT(2, 1) SLOT(3, 2) SLOT(4, 3) SLOT(5, 4) SLOT(6, 5) SLOT(7, 6)
#if ROOM > 8
    SLOT(8, 7) SLOT(9, 8) SLOT(10, 9) SLOT(11, 10)
#endif
#if ROOM > 12
    SLOT(12, 11) SLOT(13, 12)
#endif
#if ROOM > 14
    SLOT(14, 13) SLOT(15, 14) SLOT(16, 15) SLOT(17, 16) SLOT(18, 17) SLOT(19, 18)
#endif
    od
}
