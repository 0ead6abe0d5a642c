"""The task as a Gymnasium environment, with one vehicle or many.

An environment is put together from an observation (`observations.py`), a set of actions (`actions.py`) and a reward
(`rewards.py`), each chosen by its name in a registry. `Fleet` drives n vehicles with them; `TricycleEnv` and
`TricycleVectorEnv` give it Gymnasium's two forms.
"""
