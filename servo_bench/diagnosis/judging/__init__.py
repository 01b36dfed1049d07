"""From findings to a verdict, and what is told beside it.

verdict               the public schema
judgement, causes     named, none, or unknown; what is told of each cause
intervals             how sure its numbers are, and the limits
steadiness, sensors   causes that change meanwhile; channels that are not what they say
undecided             what a recording cannot tell, and which run would
picture               the error without a model of its cause: when, where, locked to what
signature, domains    how an effect shows, computed
extended              the rig with what was found, as TOML
"""
