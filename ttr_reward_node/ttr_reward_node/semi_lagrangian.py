"""proto"""
import numpy as np, time
from ctrl_rl_core.regions import position_indices
from ttr_reward_node.steps import *
from ttr_reward_node.sweep import *

def prepare(problem, cells):
    layout = make_layout(problem)
    if np.isscalar(cells): cells=(cells,)
    al=[make_steps(problem, layout, c) for c in cells]
    nd=al[0].durations.shape[1]//al[0].controls
    cat=lambda f: np.concatenate([getattr(s,f).reshape(layout.slabs,nd,s.controls,*getattr(s,f).shape[2:]) for s in al],axis=2)
    K=sum(s.controls for s in al)
    steps=Steps(cat('durations').reshape(layout.slabs,-1),np.ascontiguousarray(cat('moves').reshape(layout.slabs,nd*K,2,-1)),K)
    return layout, steps

def solve(problem, cells=2.0, interp=2, jump=.5, kink=0., tol=1e-4, max_sweeps=500, verbose=False):
    t0=time.process_time()
    layout, steps = prepare(problem, cells)
    order = layout.order
    n=len(order)
    assert layout.inner
    axes=[problem.axes[k] for k in order]
    inv=np.argsort(order)
    box=np.empty((n,2)); box[:,0]=-np.inf; box[:,1]=np.inf
    for k,a in enumerate(axes):
        if a.name in problem.target.intervals:
            iv=problem.target.intervals[a.name]
            box[k]=(iv.low-a.lower)/a.spacing,(iv.high-a.lower)/a.spacing
    disc=np.zeros(5); disc_axes=np.array([-1,-1])
    if problem.target.disc is not None:
        pi=position_indices(problem.system.state_names)
        disc_axes=inv[pi]; a,b=(problem.axes[k] for k in pi); D=problem.target.disc
        disc=np.array([D.centre[0]-a.lower,D.centre[1]-b.lower,D.radius,a.spacing,b.spacing])
    reach=np.abs(steps.moves).max(axis=(0,1,2))+1
    # flags
    near=np.zeros(problem.counts,bool)
    m=np.ones((1,)*n,bool)
    reach_o=reach[inv]
    for k,a in enumerate(problem.axes):
        lo,hi=box[inv[k]]
        if np.isfinite(hi-lo):
            i=np.arange(a.count,dtype=float)
            if a.periodic:
                c=(lo+hi)/2; i=c+(i-c+a.count/2)%a.count-a.count/2
            m=m&problem.along(k,(i>=lo-reach_o[k])&(i<=hi+reach_o[k]))
    if problem.target.disc is not None:
        i,j=pi
        pts=np.stack(np.broadcast_arrays(problem.along(i,problem.axes[i].nodes),problem.along(j,problem.axes[j].nodes)),-1)
        m=m&(problem.target.disc.signed_distance(pts)<=np.hypot(*(reach_o[k]*problem.axes[k].spacing for k in pi)))
    near|=m
    clearance=np.zeros((1,1),np.float32); cax=np.array([-1,-1])
    if problem.clearance is not None:
        ca=problem.clearance.axes
        far=np.linalg.norm([steps.moves[...,inv[k]]*problem.axes[k].spacing for k in ca],axis=0).max()
        near|=problem.spread(problem.clearance.values)<=far
        clearance=problem.clearance.values.reshape(len(problem.clearance.values),-1)
        cax=np.array([inv[ca[0]],inv[ca[-1]]])  # fixme 1d
    blocked=problem.blocked(); target=problem.in_target()&~blocked
    flags=np.where(blocked|target,np.uint8(FIXED),near.astype(np.uint8))
    values=np.where(target,np.float32(1),np.float32(0)).astype(np.float32)
    flags=np.ascontiguousarray(flags.transpose(order)).ravel(); values=np.ascontiguousarray(values.transpose(order)).ravel()
    rate=0.01
    L=layout.counts[-1]
    isn=(flags==NEAR).reshape(-1,L).sum(1)
    row_near=np.concatenate([[0],np.cumsum(isn)]).astype(np.int64)
    outcomes=np.empty((int(row_near[-1]),steps.durations.shape[1]),np.float32)
    near_outcomes(flags,layout.counts,layout.periodic,len(layout.outer),steps.durations,steps.moves,rate,steps.controls,box,disc,disc_axes,clearance,cax,outcomes)
    if verbose: print('near',row_near[-1])
    t1=time.process_time()
    for s in range(max_sweeps):
        g=s^(s>>1)
        bits=sum(((s>>0)&1)<<k for k in range(n)) if False else s%(1<<n)
        # axis 0 (slowest) alternate fastest
        r=sweep(values,flags,layout.counts,layout.periodic,len(layout.outer),steps.durations,steps.moves,rate,steps.controls,bits,interp,outcomes,row_near,jump,kink)
        if verbose: print(s,r)
        if r<tol: break
    t2=time.process_time()
    with np.errstate(divide='ignore'):
        phi=-np.log(values)/rate
    phi=np.maximum(phi,0).reshape(layout.counts).transpose(inv)
    return phi.astype(np.float32), s+1, r, t1-t0, t2-t1
