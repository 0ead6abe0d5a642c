"""Policies in their shield: which can be exported, and their source in C. See `shield.alone` for what is carried."""

from dataclasses import replace

from nnql_bullet import __version__, paper
from nnql_bullet.agents.base import Overridable, TurnChooser
from nnql_bullet.agents.learning.options import DoubleDqnOptions
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.exports.c_source import c_functions, c_struct
from nnql_bullet.exports.contract import BY_RAYS, Contract, shield_of
from nnql_bullet.exports.cost import FRAME, Cost, cost_of
from nnql_bullet.exports.names import C_EXAMPLE, C_SHIELD, C_SHIELD_HEADER
from nnql_bullet.exports.translation import ArrayOf, Function, Known, Struct, Translator, Var, group_of, struct_of
from nnql_bullet.run_config import changed
from nnql_bullet.runs import LoadedPolicy
from nnql_bullet.shield.alone import choose
from nnql_bullet.shield.perception import perceive
from nnql_bullet.shield.setting import Setting


def in_shield(policy: LoadedPolicy) -> LoadedPolicy:
    """A policy in the shield that is exported: in its own, or in the usual one, which does not lead it.

    Raises:
        UserError: If it drives on a plan, or would have to be told what the shield did instead of its action.
    """
    experiment = policy.experiment
    agent, config = experiment.agent, experiment.config
    if isinstance(agent, Overridable) and not isinstance(config.agent, DoubleDqnOptions):
        raise UserError(
            f"{policy.name}: remembers its own actions, and in a shield has to be told others; such policies, here of "
            f"kind '{config.agent.kind}', are not exported with a shield: leave it out"
        )
    if config.plan is not None:
        raise UserError(
            f"{policy.name}: drives on a plan, and its target moves on; a shield is exported for targets that stay"
        )
    shielded = changed(config, shield={"recovers": False})
    return LoadedPolicy(policy.name, Experiment(shielded, agent), policy.episodes)


def without_shield(policy: LoadedPolicy) -> LoadedPolicy:
    """A policy without its shield."""
    config = replace(policy.experiment.config, shield=None)
    return LoadedPolicy(policy.name, Experiment(config, policy.experiment.agent), policy.episodes)


def shield_files(contract: Contract, experiment: Experiment, policy_cost: Cost) -> tuple[dict[str, str], Cost]:
    """The source files of the shield by name, beside those of the policy, and what a decision takes with both.

    Args:
        contract: Of the policy in its shield.
        experiment: Of the policy in its shield.
        policy_cost: What the policy takes alone.
    """
    from nnql_bullet.exports.c99 import rendered  # it writes what is common to all C

    setting, memory = shield_of(experiment)
    struct = struct_of("m", "shield_memory", memory)
    translator = Translator()
    costs = [cost_of(its) for its in translated(translator, setting, struct)]
    operations = costs[0].operations + costs[1].operations + policy_cost.operations
    own = FRAME + 8 * (setting.rays + 4 * paper.SECTORS)
    stack = own + max(policy_cost.stack, *(its.stack for its in costs))
    sizes = {"double": 8, "int": 4, "unsigned char": 1}
    remembers = isinstance(experiment.config.agent, DoubleDqnOptions)
    values = {
        "contract": contract,
        "version": __version__,
        "turns": paper.TURNS,
        "setting": setting,
        "by_rays": isinstance(experiment.config.agent, BY_RAYS),
        "has_values": remembers or isinstance(experiment.agent, TurnChooser),
        "remembers": remembers,
        "statuses": contract.statuses,
        "struct": c_struct(struct, "policy_memory policy" if remembers else ""),
        "bytes": sum(sizes[its.stored] * its.count for its in contract.memory),
        "functions": c_functions(translator.functions, {"m": struct}),
    }
    files = {C_SHIELD: "shield.c.j2", C_SHIELD_HEADER: "shield.h.j2", C_EXAMPLE: "shield_example.c.j2"}
    return {name: rendered(template, values) for name, template in files.items()}, Cost(operations, stack)


def translated(translator: Translator, setting: Setting, struct: Struct) -> list[Function]:
    """The functions `perceive` and `choose` of a shield, and what they call."""
    p, m = Known(setting), group_of(struct)
    distances, readings = ArrayOf("distances", (setting.rays,), "real"), ArrayOf("readings", (paper.SECTORS,), "real")
    away, bearing, speed = (Var(name, "real") for name in ("target_distance", "target_bearing", "speed"))
    first = translator.translate(perceive, p, m, distances, away, bearing, speed, readings)
    values, turning = ArrayOf("values", (len(paper.TURNS),), "real"), Var("yaw_rate", "real")
    valued, wanted = Var("valued", "bool"), Var("wanted", "int")
    second = translator.translate(choose, p, m, values, valued, wanted, bearing, turning, speed)
    return [first, second]
