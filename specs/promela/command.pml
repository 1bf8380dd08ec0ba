/*
 * Class-2 send and reply over a network that loses, doubles and overtakes (§3, §5.2; D5, D6, D8, D49, D52).
 *
 * Written from specs/decisions/requirements.md and machine.md, not from the Rust.
 *
 *   SENDS            how many commands the sender sends, one after the other (1..3)
 *   RETRY            how often each may be sent again, with the same id
 *   LOSS DUP CRASH   packets that may be lost, packets that may be doubled, crashes of the receiver
 *   at most one of   NO_MEMORY             the receiver remembers no ids
 *                    FORGET_WHEN_ANSWERED  it forgets an id when it has answered it
 *                    FORGET_OLDER          the slot is emptied though a copy of an older id can still come
 *                    NO_QUARANTINE         restarted, it takes what was sent to its earlier incarnation
 *   SINGLE           another question, see below
 *   PROMPT           the receiver takes and answers each command in the step in which it arrives
 *
 * World: the sender has one command outstanding. While it waits it may send it again, and may give up at any moment: that
 * stands for every time_out. Copies stay on the way as long as they like and arrive in any order, so every way shorter than a
 * life is among them. The receiver's task takes commands from a buffer of BUFFER and answers each, whenever it likes or never.
 *
 * Memory (D52): one slot for the one source: the newest id taken, and whether it is answered. The same id again: its answer is sent again,
 * or nothing happens while it has none. An older id: dropped. A newer one: takes the slot. "Empty after life + link bound"
 * is told here by what it is for: once no copy of the id *or of an older one* is on the way or can still be sent, the slot
 * may be emptied. (FORGET_OLDER fails, a newer id having taken the slot of an older one of which a
 * copy still lives: the time that the slot is kept must not be shorter than what is left of the older life.)
 * Restart (D49): the slot, the buffer and what was being served are lost. "RESTARTED until the longest life has passed"
 * is told in the same way: commands first sent before the restart are turned away. The sender does not crash here.
 *
 * Property: no command is handed to the receiver's task twice.
 *
 * SINGLE: one command, never given up, no duplicates or crashes meant. Property: when nothing is on the way, nothing can be sent
 * again and the receiver has nothing to do, the sender has its answer. The least LOSS that violates it is searched for.
 * With PROMPT each copy that arrives brings an answer of its own; without, a copy that arrives while the first is not yet answered
 * brings none (D52).
 */

#ifndef SENDS
#define SENDS 2
#endif
#ifdef SINGLE
#undef SENDS
#define SENDS 1
#endif
#ifndef RETRY
#define RETRY 1
#endif
#ifndef LOSS
#define LOSS 1
#endif
#ifndef DUP
#define DUP 1
#endif
#ifndef CRASH
#define CRASH 0
#endif
#ifndef BUFFER
#define BUFFER 2
#endif

/* The sender: the command it sent last (0: none yet), whether it waits, how often it may send again. */
byte current;
bool waiting;
byte again;

/* On the way: copies of request k, copies of the answer to it. */
byte asks[SENDS + 1];
byte answers[SENDS + 1];

/* The receiver: copies of k in its buffer, what its task serves (0: nothing), its memory, what it turns away. */
byte stored[SENDS + 1];
byte serving;
byte slot;
bool slot_answered;
byte barred;

/* Handed to the receiver's task, in any life. */
bool executed[SENDS + 1];

byte lost, doubled, crashed;

#if SENDS == 1
#define STORED (stored[1])
#define AIR (asks[1] + answers[1])
#elif SENDS == 2
#define STORED (stored[1] + stored[2])
#define AIR (asks[1] + asks[2] + answers[1] + answers[2])
#else
#define STORED (stored[1] + stored[2] + stored[3])
#define AIR (asks[1] + asks[2] + asks[3] + answers[1] + answers[2] + answers[3])
#endif

/* A copy of what the slot holds, or of something older, is on the way. */
#ifdef FORGET_OLDER
#define CAN_COME (asks[slot] > 0)
#elif SENDS == 1
#define CAN_COME (asks[1] > 0)
#elif SENDS == 2
#define CAN_COME (asks[1] > 0 || (slot > 1 && asks[2] > 0))
#else
#define CAN_COME (asks[1] > 0 || (slot > 1 && asks[2] > 0) || (slot > 2 && asks[3] > 0))
#endif

inline execute(k)
{
    assert(!executed[k]);
    executed[k] = true
}

inline answer(k)
{
    answers[k]++;
    if
    :: slot == k ->
#if defined(FORGET_WHEN_ANSWERED)
        slot = 0; slot_answered = false
#else
        slot_answered = true
#endif
    :: else
    fi
}

inline take(k)
{
#ifdef PROMPT
    execute(k);
    answer(k)
#else
    if
    :: STORED < BUFFER -> stored[k]++
    :: else /* refused: the sender, which may give up at any moment, is not told here */
    fi
#endif
}

/* A request arrives. */
inline receive(k)
{
    if
    :: k <= barred /* RESTARTED */
    :: else ->
#ifdef NO_MEMORY
        take(k)
#else
        if
        :: slot == k && slot_answered -> answers[k]++
        :: slot == k && !slot_answered
        :: slot > k
        :: slot < k -> slot = k; slot_answered = false; take(k)
        fi
#endif
    fi
}

inline nobody_lacks_an_answer()
{
#ifdef SINGLE
    assert(!(waiting && again == 0 && AIR == 0 && STORED == 0 && serving == 0))
#else
    skip
#endif
}

#define COMMAND(k) \
    :: d_step { asks[k] > 0 -> asks[k]--; receive(k); nobody_lacks_an_answer() } \
    :: d_step { answers[k] > 0 -> \
        answers[k]--; \
        if :: waiting && current == k -> waiting = false; again = 0 :: else fi } \
    :: d_step { lost < LOSS && asks[k] > 0 -> asks[k]--; lost++; nobody_lacks_an_answer() } \
    :: d_step { lost < LOSS && answers[k] > 0 -> answers[k]--; lost++; nobody_lacks_an_answer() } \
    :: d_step { doubled < DUP && asks[k] > 0 -> asks[k]++; doubled++ } \
    :: d_step { doubled < DUP && answers[k] > 0 -> answers[k]++; doubled++ } \
    :: d_step { serving == 0 && stored[k] > 0 -> stored[k]--; serving = k; execute(k) }

active proctype world()
{
end:
    do
    :: d_step { !waiting && current < SENDS -> current++; waiting = true; again = RETRY; asks[current]++ }
    :: d_step { waiting && again > 0 -> again--; asks[current]++ }
#ifndef SINGLE
    :: d_step { waiting -> waiting = false; again = 0 }
#endif
    :: d_step { serving != 0 -> answer(serving); serving = 0 }
    /* Nothing of the id in the slot, or of an older one, can come any more. */
    :: d_step { slot != 0 && !CAN_COME && !(waiting && current == slot) -> slot = 0; slot_answered = false }
    :: d_step { crashed < CRASH ->
        crashed++;
        slot = 0; slot_answered = false; serving = 0;
        stored[1] = 0;
#if SENDS > 1
        stored[2] = 0;
#endif
#if SENDS > 2
        stored[3] = 0;
#endif
#ifndef NO_QUARANTINE
        barred = current;
#endif
        skip }
    COMMAND(1)
#if SENDS > 1
    COMMAND(2)
#endif
#if SENDS > 2
    COMMAND(3)
#endif
    od
}
