/*
 * waitfor, untimed, every packet sent once (§4.3; D1, D2).
 *
 * Written from specs/decisions/requirements.md, not from the Rust: a second opinion on how many lost packets strand a
 * member.
 *
 *   N                2..5 members
 *   LOSS             packets that may be lost at most
 *   one rule of D1   NO_CONFIRMATION, FIRST_COMPLETE, EVERY_COMPLETE (when none is given), PASS_ON
 *   FORGET           packets that change nothing any more vanish at once: a CONFIRM to a member that runs, and but for
 *                    EVERY_COMPLETE an ARRIVE to one. Without it they arrive, and change nothing. The verdict is the same.
 *
 * World: each member reaches the waitfor once, whenever it likes or never. Reaching it sends an ARRIVE to every other
 * member, as a packet of its own. Packets arrive in any order and may be lost, LOSS of them at most. Nobody gives up and no time passes.
 * Rule: a member that has reached the waitfor is released when it holds everybody's arrival, or by any CONFIRM.
 *
 *   NO_CONFIRMATION  nobody confirms
 *   FIRST_COMPLETE   who is released by holding all arrivals confirms; who a CONFIRM released does not
 *   EVERY_COMPLETE   who holds all arrivals confirms, a member that a CONFIRM released before included
 *   PASS_ON          who is released confirms, whatever released it
 *
 * Property: when nothing is on the way, no member waits in a meeting that all have reached.
 *
 * A state is bit masks. A pair of members exchanges at most one ARRIVE and one CONFIRM each way, so what is on the way
 * fits one byte per member and kind. All steps are taken by one process: there is no program counter to multiply states.
 */

#ifndef N
#define N 3
#endif
#ifndef LOSS
#define LOSS 1
#endif

#define BIT(i)  (1 << (i))
#define ALL     (BIT(N) - 1)

byte reached;      /* bit i: member i has reached the waitfor */
byte released;     /* bit i: member i runs */
byte lost;         /* how many packets were lost */
byte here[N];      /* bit j of here[i]: i holds the arrival of j; its own counts */
byte arrive[N];    /* bit j of arrive[i]: the ARRIVE from j to i is on the way */
byte confirm[N];   /* bit j of confirm[i]: the CONFIRM from j to i is on the way */

hidden byte to;

#define SEND(packets, from) \
    for (to : 0 .. N - 1) { \
        if \
        :: to != from -> packets[to] = packets[to] | BIT(from) \
        :: else \
        fi \
    }

/* Member i has just come to hold the last arrival. This happens once: every ARRIVE is sent once. */
inline complete(i)
{
#if defined(NO_CONFIRMATION)
    released = released | BIT(i)
#elif defined(FIRST_COMPLETE) || defined(PASS_ON)
    if
    :: !(released & BIT(i)) -> released = released | BIT(i); SEND(confirm, i)
    :: else
    fi
#else
    released = released | BIT(i);
    SEND(confirm, i)
#endif
}

/* A CONFIRM has reached member i. All have arrived then, so i is at the waitfor. */
inline confirmed(i)
{
    assert(reached == ALL);
#if defined(PASS_ON)
    if
    :: !(released & BIT(i)) -> released = released | BIT(i); SEND(confirm, i)
    :: else
    fi
#else
    released = released | BIT(i)
#endif
}

#if N == 2
#define ON_THE_WAY (arrive[0] | arrive[1] | confirm[0] | confirm[1])
#elif N == 3
#define ON_THE_WAY (arrive[0] | arrive[1] | arrive[2] | confirm[0] | confirm[1] | confirm[2])
#elif N == 4
#define ON_THE_WAY (arrive[0] | arrive[1] | arrive[2] | arrive[3] | confirm[0] | confirm[1] | confirm[2] | confirm[3])
#else
#define ON_THE_WAY (arrive[0] | arrive[1] | arrive[2] | arrive[3] | arrive[4] \
                  | confirm[0] | confirm[1] | confirm[2] | confirm[3] | confirm[4])
#endif

/* What is on the way to a member that runs. */
inline forget(i)
{
#ifdef FORGET
    if
    :: released & BIT(i) ->
        confirm[i] = 0;
#if defined(NO_CONFIRMATION) || defined(FIRST_COMPLETE) || defined(PASS_ON)
        arrive[i] = 0
#endif
    :: else
    fi
#else
    skip
#endif
}

inline forget_all()
{
#ifdef FORGET
    forget(0); forget(1);
#if N > 2
    forget(2);
#endif
#if N > 3
    forget(3);
#endif
#if N > 4
    forget(4);
#endif
#endif
    skip
}

inline judge()
{
    forget_all();
    assert(!(reached == ALL && released != ALL && ON_THE_WAY == 0))
}

#define REACHES(i) \
    :: d_step { !(reached & BIT(i)) -> \
        reached = reached | BIT(i); \
        here[i] = here[i] | BIT(i); \
        SEND(arrive, i); \
        if :: here[i] == ALL -> complete(i) :: else fi; \
        forget_all() }

/* What j has sent to i arrives or is lost. */
#define PACKETS(j, i) \
    :: d_step { (arrive[i] & BIT(j)) -> \
        arrive[i] = arrive[i] ^ BIT(j); \
        here[i] = here[i] | BIT(j); \
        if :: here[i] == ALL -> complete(i) :: else fi; \
        judge() } \
    :: d_step { (confirm[i] & BIT(j)) -> \
        confirm[i] = confirm[i] ^ BIT(j); \
        confirmed(i); \
        judge() } \
    :: d_step { lost < LOSS && (arrive[i] & BIT(j)) -> \
        arrive[i] = arrive[i] ^ BIT(j); \
        lost++; \
        judge() } \
    :: d_step { lost < LOSS && (confirm[i] & BIT(j)) -> \
        confirm[i] = confirm[i] ^ BIT(j); \
        lost++; \
        judge() }

active proctype world()
{
end:
    do
    REACHES(0) REACHES(1)
    PACKETS(0, 1) PACKETS(1, 0)
#if N > 2
    REACHES(2)
    PACKETS(0, 2) PACKETS(1, 2) PACKETS(2, 0) PACKETS(2, 1)
#endif
#if N > 3
    REACHES(3)
    PACKETS(0, 3) PACKETS(1, 3) PACKETS(2, 3) PACKETS(3, 0) PACKETS(3, 1) PACKETS(3, 2)
#endif
#if N > 4
    REACHES(4)
    PACKETS(0, 4) PACKETS(1, 4) PACKETS(2, 4) PACKETS(3, 4) PACKETS(4, 0) PACKETS(4, 1) PACKETS(4, 2) PACKETS(4, 3)
#endif
    od
}
