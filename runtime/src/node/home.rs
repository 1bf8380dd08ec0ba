//! Where the communication tasks of a node are: in which domain, and at which position there (D186).

use imrs_protocol::TaskId;

/// Which thread runs the program of a task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RunBy {
    /// A thread of the task's own runs the program.
    ItsThread,
    /// The program is a script. The thread that brings input for it runs it.
    AnyThread,
    /// The program is a future. The thread of the futures runs it.
    TheThreadOfFutures,
}

/// Where a communication task of the node is: in which domain (tasks that share one lock), and at which position there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Home {
    // These numbers are short because a home goes along with each packet. A cell has at most 65,536 tasks.
    place: u16,
    domain: u16,
    member: u16,
    /// Which thread runs the task's program: the same for all tasks of a domain (they share one lock).
    pub run_by: RunBy,
}

impl Home {
    /// The task's position among the node's tasks.
    pub const fn place(self) -> usize {
        self.place as usize
    }

    /// The number of the task's domain: the position on the node of the domain's first member.
    pub const fn domain(self) -> usize {
        self.domain as usize
    }

    /// The task's position in its domain (the tasks that share one lock).
    pub const fn member(self) -> usize {
        self.member as usize
    }
}

/// The home of each communication task of a node: its domain (the tasks that share one lock), and its position there.
#[derive(Debug)]
pub(crate) struct Homes {
    /// The home of each task of the cell; `None` for tasks of other nodes.
    of_task: Box<[Option<Home>]>,
    /// The home of each task of the node, in the order of the tasks.
    of_place: Box<[Home]>,
}

impl Homes {
    /// Makes the homes of `local`, the tasks of a node in ascending order, each with the thread that runs it. The cell
    /// has `tasks` tasks.
    pub fn new(local: impl Iterator<Item = (TaskId, RunBy)>, tasks: usize) -> Self {
        let mut of_task = vec![None; tasks];
        let mut of_place = Vec::new();
        let (mut scripts, mut futures) = (None, None);
        for (place, (task, run_by)) in (0..).zip(local) {
            let shared: Option<&mut Option<(u16, u16)>> = match run_by {
                RunBy::ItsThread => None,
                RunBy::AnyThread => Some(&mut scripts),
                RunBy::TheThreadOfFutures => Some(&mut futures),
            };
            let (domain, member) = match shared {
                None => (place, 0),
                Some(shared) => {
                    let (domain, count) = shared.get_or_insert((place, 0));
                    *count += 1;
                    (*domain, *count - 1)
                }
            };
            let home = Home { place, domain, member, run_by };
            of_place.push(home);
            of_task[task.index()] = Some(home);
        }
        Self { of_task: of_task.into(), of_place: of_place.into() }
    }

    /// The home of `task`, if this node runs it.
    pub fn of(&self, task: TaskId) -> Option<Home> {
        self.of_task.get(task.index()).copied().flatten()
    }

    /// The home of the task with the position `place` among the tasks of the node.
    pub fn at(&self, place: usize) -> Home {
        self.of_place[place]
    }
}
